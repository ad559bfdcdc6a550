"""What a command is asked to look at: trained morphs, ours from checkpoints and the authors' by name."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.errors import InputError
from nsm.io.checkpoint import find_checkpoint, load_morph
from nsm.io.official import load_official, official_name
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.growth import Grown, build_growth
from nsm.types import Morph

log = logging.getLogger(__name__)

#: What ``checkpoint`` and ``official`` may be: nothing, one, or a list.
Names = str | Sequence[str] | None
#: Beginning of the origin of an official morph, before its name.
PUBLISHED = "official/morphs/"
#: What ``ends`` may be.
ENDS = ("exact", "network")


class LoadedMorph(NamedTuple):
    """A morph, with what people call it.

    Attributes:
        name: short, and different from the others'.
        origin: the checkpoint's path, or ``official/morphs/…``.
        morph: ready for inference, with the ends and the changing volume that were asked for.
        folder: of the run, None for an official morph.
        exact: the morph at constant volume if its ends are exact, else None.
        network: the morph of the networks alone, with the changing volume; None where that is ``morph``.
    """

    name: str
    origin: str
    morph: Morph
    folder: Path | None
    exact: ExactEnds | None = None
    network: Morph | None = None


def load_morphs(config: Mapping[str, Any], command: str) -> list[LoadedMorph]:
    """Load all morphs that are named, each once, checkpoints first.

    Args:
        config: ``checkpoint``, checkpoints or folders of runs; ``official``, names of published morphs; ``growth``,
            how their volume changes (`nsm.morphs.growth.build_growth`), relative to what each has. The volumes that a
            growth takes by itself are those of the two shapes before they were scaled to one, which a checkpoint tells;
            ``ends``, whether those of a checkpoint's morph are the shapes themselves or the networks'. Published morphs
            are as their authors made them.
        command: for the sentence when nothing is named.

    Raises:
        InputError: if nothing is named, or something that is not there or cannot be read, or there is no such growth.
    """
    files = list(dict.fromkeys(find_checkpoint(path) for path in _listed(config["checkpoint"])))
    pairs = list(dict.fromkeys(official_name(name) for name in _listed(config["official"])))
    if not files and not pairs:
        raise InputError(
            f"no morph is named: type python -m {command} checkpoint=PATH (a .ckpt file or the folder of a run), or "
            "official=kitten_fandisk for one of the authors'"
        )
    growth, ends = config["growth"], known_ends(config["ends"])
    ours = [load_run(name, file, ends, growth) for name, file in zip(_short_names(files), files, strict=True)]
    return ours + [load_published(name, growth) for name in pairs]


def known_ends(ends: Any) -> str:
    """The setting ``ends``: ``exact`` for the shapes themselves at the ends, ``network`` for the networks'.

    Raises:
        InputError: if it is neither.
    """
    if ends not in ENDS:
        raise InputError(f"`ends` must be {' or '.join(ENDS)}, got {ends}. Try `ends=exact`.")
    return str(ends)


def exact_ends(morph: Morph, name: str) -> ExactEnds | None:
    """The morph with its two shapes as exact ends; None if it has no velocity to advect detail, which is logged."""
    if morph.has_velocity:
        return ExactEnds(morph)
    log.info("%s has no velocity to advect detail, so its ends are those of the network, as with ends=network", name)
    return None


def load_run(name: str, file: Path, ends: str, growth: Mapping[str, Any] | None = None) -> LoadedMorph:
    """Load the morph of a checkpoint.

    Args:
        name: Name of the morph in tables and pictures.
        file: Checkpoint.
        ends: ``exact`` for the end shapes themselves at t = 0 and 1, ``network`` for what the networks learned of them.
            Without a velocity, both are the network's (`exact_ends`).
        growth: How the volume changes, see `load_morphs`.
    """
    network = load_morph(file)
    exact = exact_ends(network, name) if ends == "exact" else None
    bare, folder = _grown(network, growth), run_folder(file)
    if exact is None:
        return LoadedMorph(name, str(file), bare, folder)
    return LoadedMorph(name, str(file), _grown(exact, growth), folder, exact, bare)


def load_published(name: str, growth: Mapping[str, Any] | None = None) -> LoadedMorph:
    """Load one of the authors' morphs, whose ends are those of its networks."""
    morph = _grown(load_official(name), growth)
    return LoadedMorph(f"{name} (official)", f"{PUBLISHED}{name}", morph, None)


def _grown(morph: Morph, config: Mapping[str, Any] | None) -> Morph:
    """The morph with the growth of a configuration; itself without one."""
    scales = [float(morph.provenance.get(end, {}).get("scale", 1.0)) for end in ("source", "target")]
    source, target = (scale**-morph.dim for scale in scales)  # 1 for a shape that was not scaled
    growth = build_growth(config, morph.dim, (source, target))
    return morph if growth is None else Grown(morph, growth)


def run_folder(file: Path) -> Path:
    """The folder of the run that wrote a checkpoint."""
    return file.parent.parent if file.parent.name == "checkpoints" else file.parent


def output_folder(subjects: Sequence[LoadedMorph], work: str) -> Path:
    """Where a command writes unless told otherwise: in the folder of a run that it looks at alone, else in ``outputs``.

    Args:
        subjects: what it looks at.
        work: what it writes, such as ``export``.
    """
    if len(subjects) == 1 and subjects[0].folder is not None:
        return subjects[0].folder / work
    name = Path(subjects[0].origin).name if len(subjects) == 1 else datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    return Path("outputs") / f"{work}s" / name


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
