"""Files of Lightning's checkpoints, written as all files are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO

from nsm.io.checkpoint import write_content


class WholeCheckpoints(TorchCheckpointIO):
    """Writes checkpoints beside their place and renames them (`nsm.cli.files.atomic_write`).

    Lightning's own class writes into the temporary folder and moves the file, which copies it over the old one where
    that folder is on another file system.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint; ``storage_options`` are those of remote storage, which nsm does not use."""
        write_content(Path(path), checkpoint)
