"""Summary of a run: ``summary.json``, and a few lines that name its most important files."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from nsm.cli.files import atomic_write
from nsm.cli.progress import duration

log = logging.getLogger(__name__)

#: Relative end-volume error above which training warns.
VOLUME_WARNING = 0.05
#: Figures that matter in a line or a table: their names, short names, and formats.
FIGURES = {
    "val/error": ("error", "{:.2g}"),
    "val/volume_max": ("volume", "±{:.2%}"),
    "val/volume_error": ("ends", "±{:.2%}"),
    "val/components": ("components", "{:.0f}"),
    "val/normal": ("normals", "{:.1f}°"),
}
#: Name of the summary, the last file that a run writes.
SUMMARY = "summary.json"
#: Files that a user opens first, most important first.
_FILES = ("checkpoints/best.ckpt", "strip.png", SUMMARY)


@dataclass(frozen=True)
class Summary:
    """Outcome of a run.

    Attributes:
        steps: Optimizer steps; 0 for optimal transport.
        training: Seconds of training or computing, also those before the run was stopped and resumed.
        figures: Validation of the morph or shape that the run ends with, by the names of the log.
        preparing: Seconds before that.
        best_step: Step of the best checkpoint.
    """

    steps: int
    training: float
    figures: Mapping[str, float] = field(default_factory=dict)
    preparing: float = 0.0
    best_step: int = 0

    def write(self, folder: Path) -> None:
        """Write ``summary.json``."""
        content = {
            "steps": self.steps,
            "best_step": self.best_step,
            "preparing_s": self.preparing,
            "training_s": self.training,
            **self.figures,
        }
        with atomic_write(folder / SUMMARY) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")

    def report(self, folder: Path) -> None:
        """Log the figures and the files to open first, and a warning if the volume at an end is wrong."""
        if (error := self.figures.get("val/volume_error", 0.0)) > VOLUME_WARNING:
            log.warning(
                "The volume of the morph differs from that of its end shapes by %.0f %%. Look at the strip for pieces "
                "that belong to neither, and train with half of `optimizer.lr` or more steps.",
                100 * error,
            )
        made = f"{self.steps} steps in {duration(self.training)}" if self.steps else f"{duration(self.training)}"
        best = f"; best at step {self.best_step}" if self.steps else ""
        log.info("Finished: %s, after %s of preparation%s", made, duration(self.preparing), best)
        if shown := ", ".join(shown_figures(self.figures)):
            log.info("  %s", shown)
        log.info("Files in %s", folder)
        log.info("  %s", "  ".join(name for name in _FILES if (folder / name).is_file()))


def shown_figures(figures: Mapping[str, float]) -> list[str]:
    """Write the figures that matter with their short names, as in ``error 0.0031``.

    >>> shown_figures({"val/error": 0.0031, "val/volume_max": 0.002, "val/slope": 1.0})
    ['error 0.0031', 'volume ±0.20%']
    """
    return [f"{name} {text.format(figures[key])}" for key, (name, text) in FIGURES.items() if key in figures]
