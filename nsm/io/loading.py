"""Loading of the morphs that a command is given: checkpoints by path, and the authors' morphs by name."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.errors import InputError
from nsm.cli.settings import choice
from nsm.io.build import build
from nsm.io.checkpoint import find_checkpoint, load_morph
from nsm.io.official import load_official, official_name
from nsm.io.timing import build_timing
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.exact_keys import ExactKeys
from nsm.morphs.growth import UNSCALED, Grown, Growth
from nsm.morphs.timing import Retimed
from nsm.types import Morph

log = logging.getLogger(__name__)

#: Type of the settings ``checkpoint`` and ``official``: nothing, one name, or a list.
Names = str | Sequence[str] | None
#: Beginning of the origin of an official morph, before its name.
PUBLISHED = "official/morphs/"
#: Valid values of the setting ``ends``.
ENDS = ("exact", "network")


class LoadedMorph(NamedTuple):
    """A morph with its name and origin.

    Attributes:
        name: Short name, unique among the morphs that were loaded together.
        origin: Path of the checkpoint, or ``official/morphs/…``.
        morph: The morph, ready for inference, with the requested ends and growth.
        folder: Folder of the run, None for an official morph.
        exact: The morph with exact ends before it grows; None if its ends are those of the networks.
        network: The morph of the networks alone, with the same growth; None if that is ``morph`` itself.
    """

    name: str
    origin: str
    morph: Morph
    folder: Path | None
    exact: ExactEnds | ExactKeys | None = None
    network: Morph | None = None


def load_morphs(config: Mapping[str, Any], command: str) -> list[LoadedMorph]:
    """Load all named morphs, checkpoints first, each of them once.

    Args:
        config: Settings of the command. ``checkpoint`` names checkpoints or folders of runs, ``official`` names
            published morphs. ``growth`` is the change of volume relative to that of each morph (`build_growth`); its
            default volumes are those of the shapes before they were scaled to one volume, according to the
            checkpoint. ``ends`` selects the ends of checkpoints (`load_run`).
        command: Module of the command, for the error message.

    Raises:
        InputError: If nothing is named, a file does not exist or cannot be read, or a setting is invalid.
    """
    files = list(dict.fromkeys(find_checkpoint(path) for path in _listed(config["checkpoint"])))
    pairs = list(dict.fromkeys(official_name(name) for name in _listed(config["official"])))
    if not files and not pairs:
        raise InputError(
            "`checkpoint` must be a .ckpt file or the folder of a run, got nothing. Try "
            f"`python -m {command} checkpoint=outputs/demo`, or `official=kitten_fandisk` for a morph of the authors."
        )
    growth, ends = config["growth"], known_ends(config["ends"])
    ours = [load_run(name, file, ends, growth) for name, file in zip(_short_names(files), files, strict=True)]
    return ours + [load_published(name, growth) for name in pairs]


def known_ends(ends: Any) -> str:
    """Validate the setting ``ends``, see `load_run`.

    Raises:
        InputError: If it is not one of `ENDS`.
    """
    return choice("ends", ends, ENDS)


def exact_ends(morph: Morph, name: str) -> ExactEnds | ExactKeys | None:
    """The morph that equals its shapes exactly; None if it has no velocity to advect detail, which is logged."""
    if morph.has_velocity:
        return ExactEnds(morph) if len(morph.keys) == 2 else ExactKeys(morph)
    log.info("%s has no velocity to advect detail, so its ends are those of the network, as with ends=network", name)
    return None


def load_run(name: str, file: Path, ends: str, growth: Mapping[str, Any] | None = None) -> LoadedMorph:
    """Load the morph of a checkpoint.

    Args:
        name: Name of the morph in tables and pictures.
        file: Checkpoint.
        ends: ``exact`` for the shapes themselves at their times, ``network`` for what the networks learned of them.
            Without a velocity, both are the network's (`exact_ends`).
        growth: Config of the change of volume, see `build_growth`.
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
    """Apply the growth of a configuration to a morph; without one, return the morph itself."""
    known = morph.provenance
    origins = [known.get("source", {}), *known.get("between", ()), known.get("target", {})]
    scales = [float(origin.get("scale", 1.0)) for origin in origins]  # 1 for a shape that was not scaled
    own = {key.time: scale**-morph.dim for key, scale in zip(morph.keys, scales, strict=True)}
    growth = build_growth(config, morph.dim, own)
    return morph if growth is None else Grown(morph, growth)


def build_growth(config: Mapping[str, Any] | None, dim: int, own: Mapping[float, float] = UNSCALED) -> Growth | None:
    """Instantiate the growth of a configuration; None for one without a ``_target_`` (``growth=none``).

    Args:
        config: ``_target_``, a subclass of `Growth`, and its arguments.
        dim: Dimension d of space.
        own: Relative volumes of the shapes, by their times, before they were scaled to one volume.

    Raises:
        InputError: If the target is not a growth, or does not take these arguments.
    """
    if not config or config.get("_target_") is None:
        return None
    try:
        return build({**config, "dim": dim, "own": own}, Growth)
    except TypeError as error:
        arguments = {name: value for name, value in config.items() if name != "_target_"}
        raise InputError(
            f"`growth` must have the arguments of {config['_target_']}, got {arguments} ({error}). Try "
            "`growth=volume_linear`."
        ) from error


def retimed(loaded: Sequence[LoadedMorph], config: Mapping[str, Any]) -> list[LoadedMorph]:
    """Let the morphs follow the timing of a configuration, so that their times are those of a film.

    Args:
        loaded: Morphs, in their own time.
        config: ``_target_``, a subclass of `Timing`, and its arguments (``conf/timing``).

    Raises:
        InputError: If the target is not a timing, or does not take these arguments.
    """
    timing = build_timing(config)
    if timing is None:
        return list(loaded)
    return [
        each._replace(morph=Retimed(each.morph, timing), network=each.network and Retimed(each.network, timing))
        for each in loaded
    ]


def run_folder(file: Path) -> Path:
    """Folder of the run that wrote a checkpoint."""
    return file.parent.parent if file.parent.name == "checkpoints" else file.parent


def output_folder(loaded: Sequence[LoadedMorph], work: str) -> Path:
    """Default output folder of a command: in the folder of the run if there is one only, otherwise in ``outputs``.

    Args:
        loaded: Morphs that the command works on.
        work: Name of its results, such as ``export``.
    """
    if len(loaded) == 1 and loaded[0].folder is not None:
        return loaded[0].folder / work
    name = Path(loaded[0].origin).name if len(loaded) == 1 else datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    return Path("outputs") / f"{work}s" / name


def _listed(names: Names) -> list[str]:
    if names is None:
        return []
    return [names] if isinstance(names, str) else [str(name) for name in names]


def _short_names(files: list[Path]) -> list[str]:
    """Shortest endings of the paths that tell all runs apart, with the name of the file if a run occurs twice."""
    runs = [run_folder(file).resolve() for file in files]
    twice = {run for run in runs if runs.count(run) > 1}
    paths = [run / file.stem if run in twice else run for run, file in zip(runs, files, strict=True)]
    length = 1
    while len({path.parts[-length:] for path in paths}) < len(paths):
        length += 1
    return ["/".join(path.parts[-length:]) for path in paths]
