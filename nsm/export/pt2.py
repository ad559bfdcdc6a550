"""pt2: the fields as a program of ``torch.export``.

References:
    https://docs.pytorch.org/docs/stable/export.html
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import torch

from nsm.cli.files import atomic_write
from nsm.export.network_format import DESCRIPTION, traced
from nsm.types import Morph


def write_pt2(path: Path | str, morph: Morph) -> None:
    """Write the fields as a program of ``torch.export``, with their description as its extra file ``nsm.json``.

    Args:
        path: The file to write.
        morph: A morph of networks.

    Raises:
        InputError: If the morph is not made of networks, or the file cannot be written.
    """
    networks = morph.networks()
    program = traced(networks)
    data = io.BytesIO()  # torch would abort the process on a full disk
    torch.export.save(program, data, extra_files={DESCRIPTION: json.dumps(networks.description)})
    with atomic_write(path) as temporary:
        temporary.write_bytes(data.getbuffer())
