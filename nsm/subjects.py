"""What a command is asked to look at: trained morphs, ours from checkpoints and the authors' by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from nsm.checkpoint import find_checkpoint, load_morph
from nsm.errors import InputError
from nsm.morph import NeuralMorph
from nsm.official import load_official, official_name

#: What ``checkpoint`` and ``official`` may be: nothing, one, or a list.
Names = str | Sequence[str] | None


class Subject(NamedTuple):
    """A morph, with what people call it.

    Attributes:
        name: short, and different from the others'.
        origin: the checkpoint's path, or ``official/morphs/…``.
        morph: ready for inference.
        folder: of the run, None for an official morph.
    """

    name: str
    origin: str
    morph: NeuralMorph
    folder: Path | None


def load_subjects(checkpoint: Names, official: Names, command: str) -> list[Subject]:
    """Load all morphs that are named, each once, checkpoints first.

    Args:
        checkpoint: checkpoints or folders of runs.
        official: names of published morphs.
        command: for the sentence when nothing is named.

    Raises:
        InputError: if nothing is named, or something that is not there or cannot be read.
    """
    files = list(dict.fromkeys(find_checkpoint(path) for path in _listed(checkpoint)))
    pairs = list(dict.fromkeys(official_name(name) for name in _listed(official)))
    if not files and not pairs:
        raise InputError(
            f"no morph is named: type python -m {command} checkpoint=PATH (a .ckpt file or the folder of a run), or "
            "official=kitten_fandisk for one of the authors'"
        )
    names = _short_names(files)
    ours = [
        Subject(name, str(file), load_morph(file), run_folder(file)) for name, file in zip(names, files, strict=True)
    ]
    theirs = [Subject(f"{name} (official)", f"official/morphs/{name}", load_official(name), None) for name in pairs]
    return ours + theirs


def run_folder(file: Path) -> Path:
    """The folder of the run that wrote a checkpoint."""
    return file.parent.parent if file.parent.name == "checkpoints" else file.parent


def whole_number(name: str, value: Any, least: int) -> int:
    """A setting that must be a whole number of at least ``least``.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise InputError(f"{name}={value} cannot be: give a whole number of at least {least}")
    return value


def _listed(names: Names) -> list[str]:
    if names is None:
        return []
    return [names] if isinstance(names, str) else [str(name) for name in names]


def _short_names(files: list[Path]) -> list[str]:
    """The shortest endings of the paths by which all runs differ; the name of the file too where a run comes twice."""
    runs = [run_folder(file).resolve() for file in files]
    twice = {run for run in runs if runs.count(run) > 1}
    paths = [run / file.stem if run in twice else run for run, file in zip(runs, files, strict=True)]
    length = 1
    while len({path.parts[-length:] for path in paths}) < len(paths):
        length += 1
    return ["/".join(path.parts[-length:]) for path in paths]
