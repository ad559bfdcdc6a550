"""Training from Python: the training command's own configuration and functions, behind keyword arguments."""

from __future__ import annotations

import io
import os
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.locks import scratch_folder
from nsm.cli.overrides import literal
from nsm.cli.settings import invalid, nearest
from nsm.cli.validation import validate
from nsm.io.loading import known_ends
from nsm.io.mesh import write_mesh
from nsm.library.trained import TrainedMorph, load_morph
from nsm.train import __main__ as training
from nsm.types import SimplexMesh

#: Options of ``conf/train.yaml``, which need not be chosen again.
_DEFAULTS = {"budget": "full", "method": "adadiv"}
#: A shape as `morph` takes it: a mesh, its vertices (v, 3) and faces (m, 3), points (n, 3), points with normals (n, 6),
#: a file of any kind (`nsm.io.shape_file.read_shape`), or a name of ``conf/shape``.
ShapeLike = trimesh.Trimesh | trimesh.PointCloud | np.ndarray | str | os.PathLike[str] | tuple[Any, Any]
#: Landmarks as `morph` takes them: a CSV file, points of the source and of the target, or a name of ``conf/landmarks``.
LandmarksLike = str | os.PathLike[str] | Sequence[Any]


def morph(
    source: ShapeLike,
    target: ShapeLike,
    *,
    budget: str = "full",
    steps: int | None = None,
    method: str = "adadiv",
    seed: int = 0,
    ends: str = "exact",
    between: Sequence[ShapeLike] = (),
    times: Sequence[float] | None = None,
    landmarks: LandmarksLike | None = None,
    output: str | os.PathLike[str] | None = None,
    source_settings: Mapping[str, Any] | None = None,
    target_settings: Mapping[str, Any] | None = None,
    between_settings: Mapping[str, Any] | None = None,
    **options: Any,
) -> TrainedMorph:
    """Train a morph between two or more shapes, as ``python -m nsm.train`` does.

    Args:
        source: Shape at t = 0: a `trimesh.Trimesh` or `trimesh.PointCloud`, the path of a file, a pair of vertices
            (v, 3) and faces (m, 3), an array of points (n, 3) or of points with normals (n, 6), or the name of a file
            in ``conf/shape``.
        target: Shape at t = 1.
        budget: ``full``, ``fast`` (a quarter of the steps), or another file in ``conf/budget``.
        steps: Number of optimizer steps; None for those of the budget.
        method: A file in ``conf/method``.
        seed: Seed of all random numbers.
        ends: ``exact`` or ``network``, as for `load_morph`.
        between: Shapes that the morph passes through on its way from the source to the target, in order.
        times: Times of all shapes, from 0 for the source to 1 for the target; None spaces them evenly.
        landmarks: Corresponding points that V carries from the source to the target, in the coordinates of the shapes
            as given: the path of a CSV file, a pair of arrays (k, d) on the source and on the target, or the name of a
            file in ``conf/landmarks``.
        output: Folder of the run, which keeps its checkpoints and logs; None keeps the morph in memory only.
        source_settings: Settings of the source, such as ``{"label": 3}`` for a volume of labels or
            ``{"up": [0, 0, 1]}``, by their names in ``conf/shape``.
        target_settings: Settings of the target.
        between_settings: Settings of every shape between them.
        options: Any other choice or setting of ``conf/train.yaml``: a choice by the name of its file
            (``velocity="nulldiv"``), settings of a group as a dictionary (``optimizer={"lr": 5e-4}``), or both as
            a pair (``symmetry=("plane", {"normal": [1, 1, 0]})``).

    Returns:
        The morph of the best validation.

    Raises:
        InputError: If a shape cannot be read, or an option is unknown or out of range.

    Example:
        >>> import nsm, trimesh
        >>> ball, box = trimesh.creation.icosphere(), trimesh.creation.box()
        >>> result = nsm.morph(ball, box, budget="fast")  # doctest: +SKIP
        >>> result.mesh(0.5).is_watertight  # doctest: +SKIP
        True
    """
    ends = known_ends(ends)
    with scratch_folder(Path(tempfile.gettempdir())) as temporary:
        folder = Path(temporary if output is None else output).resolve()
        names = [f"between.key{number}" for number in range(1, len(between) + 1)]
        places = dict(zip(["source", *names, "target"], [source, *between, target], strict=True))
        shapes = [override for place, shape in places.items() for override in _shape(place, shape, folder)]
        shapes += [] if landmarks is None else _landmarks(landmarks, folder)
        settings = {"source": source_settings, "target": target_settings, **dict.fromkeys(names, between_settings)}
        # the default method and budget leave its parts to the options; a method that is named keeps them
        named = {"budget": budget, "method": method}
        named = {group: option for group, option in named.items() if option != _DEFAULTS[group]}
        choices = {"callbacks": "none", **named, **options, "seed": seed}
        choices |= {place: given for place, given in settings.items() if given}
        choices |= {name: value for name, value in (("steps", steps), ("times", times)) if value is not None}
        _train(folder, shapes, choices)
        return load_morph(folder, ends=ends)


def _shape(place: str, shape: ShapeLike, folder: Path) -> list[str]:
    """The overrides that choose a shape; one that is in memory is first written to the folder of the run."""
    if isinstance(shape, str) and shape in _variants("shape"):
        return [_chosen(place, shape)]
    if isinstance(shape, str | os.PathLike):
        path = Path(shape).expanduser()
        return _from_file(place, "file", path.resolve() if path.exists() else shape)
    if isinstance(shape, trimesh.PointCloud | np.ndarray):
        points = folder / f"{place}.npy"
        data = io.BytesIO()
        np.save(data, shape if isinstance(shape, np.ndarray) else np.asarray(shape.vertices))
        with atomic_write(points) as file:
            file.write_bytes(data.getbuffer())
        return _from_file(place, "points", points)
    vertices, faces = (shape.vertices, shape.faces) if isinstance(shape, trimesh.Trimesh) else shape
    arrays = torch.as_tensor(np.asarray(vertices, dtype=np.float64)), torch.as_tensor(np.asarray(faces, dtype=np.int64))
    if any(array.ndim != 2 or array.shape[1] != 3 for array in arrays):
        raise InputError(
            f"`{place}` must be vertices of shape (v, 3) and faces of shape (m, 3), got {tuple(arrays[0].shape)} and "
            f"{tuple(arrays[1].shape)}. Try the path of a mesh."
        )
    file = folder / f"{place}.ply"
    write_mesh(file, SimplexMesh(*arrays))
    return _from_file(place, "mesh", file)


def _from_file(place: str, kind: str, path: str | os.PathLike[str]) -> list[str]:
    return [_chosen(place, kind), f"{place}.path={literal(str(path))}"]


def _chosen(place: str, kind: str) -> str:
    """The override that chooses a file of ``conf/shape``; shapes between the ends are not in the default list."""
    return f"{'+' if '.' in place else ''}shape@{place}={kind}"


def _landmarks(landmarks: LandmarksLike, folder: Path) -> list[str]:
    """The overrides that choose landmarks; those in memory are first written to the folder of the run."""
    if isinstance(landmarks, str) and landmarks in _variants("landmarks"):
        return [f"landmarks={landmarks}"]
    if isinstance(landmarks, str | os.PathLike):
        path = Path(landmarks).expanduser()
        return ["landmarks=table", f"landmarks.path={literal(str(path.resolve() if path.exists() else landmarks))}"]
    arrays = [np.asarray(points, dtype=np.float64) for points in landmarks]
    if len(arrays) != 2 or arrays[0].ndim != 2 or arrays[0].shape != arrays[1].shape:
        raise InputError(
            "`landmarks` must be two arrays of the same shape (k, d), got "
            f"{' and '.join(str(points.shape) for points in arrays)}. Try the path of a CSV file."
        )
    file = folder / "landmarks.csv"
    with atomic_write(file) as temporary:
        np.savetxt(temporary, np.hstack(arrays), fmt="%.17g", delimiter=",")
    return ["landmarks=table", f"landmarks.path={literal(str(file))}"]


def _train(folder: Path, shapes: list[str], options: Mapping[str, Any]) -> None:
    """Run the training command in a folder.

    Raises:
        InputError: If an option is unknown or cannot be used.
        KeyboardInterrupt: If training was stopped by Ctrl-C; its last step is kept in the folder.
    """
    choices = [*shapes, *_choices(options)]
    settings = _settings(_composed(choices, folder), options)
    with _as_current_run(_composed([*choices, *settings], folder)) as cfg:
        try:
            validate(cfg, "train")
            training.main(cfg)
        except SystemExit as stop:
            if stop.code == 128 + signal.SIGINT:
                raise KeyboardInterrupt from None
            raise
        except HydraException as error:
            if isinstance(error.__cause__, InputError):
                raise error.__cause__ from None
            raise


def _composed(overrides: list[str], folder: Path) -> DictConfig:
    """The configuration of the training command, with Hydra's own part."""
    places = [f"hydra.{place}={literal(str(folder))}" for place in ("run.dir", "runtime.output_dir")]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        try:
            return compose("train", [*overrides, *places], return_hydra_config=True)
        except (HydraException, OmegaConfBaseException) as error:
            raise InputError(
                f"The options must compose, got: {' '.join(str(error).split())}. Try `nsm train --help`."
            ) from error


@contextmanager
def _as_current_run(cfg: DictConfig) -> Iterator[DictConfig]:
    """Let ``${hydra:…}`` mean this configuration, and give it without Hydra's own part."""
    current = HydraConfig.instance()
    before = current.cfg
    current.set_config(cfg)
    try:
        yield OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "hydra"])
    finally:
        current.cfg = before


def _choices(options: Mapping[str, Any]) -> list[str]:
    """The overrides for options that name a file of a group.

    Raises:
        InputError: If the group has no such file.
    """
    chosen = {
        name: value[0] if isinstance(value, tuple) else value for name, value in options.items() if _names(name, value)
    }
    for name, value in chosen.items():
        if value not in _variants(name):
            near = nearest(value, _variants(name)) or _variants(name)[0]
            raise invalid(name, f"one of {', '.join(_variants(name))}", value, near)
    return [f"{name}={value}" for name, value in chosen.items()]


def _settings(cfg: DictConfig, options: Mapping[str, Any]) -> list[str]:
    """The overrides for all other options, and for the settings of a file that is named with some.

    Raises:
        InputError: If there is no such setting.
    """
    found = []
    for name, value in options.items():
        if _names(name, value) and not isinstance(value, tuple):
            continue
        for key, entry in _flat(name, value[1] if _names(name, value) else value):
            _require_setting(cfg, key)
            found.append(f"{key}={literal(entry)}")
    return found


def _names(name: str, value: Any) -> bool:
    """Whether an option names a file of a group, alone or in a pair with settings of that file."""
    return name in _groups() and (isinstance(value, str) or (isinstance(value, tuple) and len(value) == 2))


def _require_setting(cfg: DictConfig, key: str) -> None:
    *parents, last = key.split(".")
    node: Any = cfg
    for part in parents:
        node = node[part] if isinstance(node, DictConfig) and part in node else None
    if isinstance(node, DictConfig) and last in list(node):  # a value that must be given is not `in` the node
        return
    known = [str(name) for name in (node if isinstance(node, DictConfig) else cfg) if name != "hydra"]
    place = f"setting of `{'.'.join(parents)}`" if parents else "option of training"
    near = nearest(last, known) or "nsm train --help"
    raise InputError(f"`{key}` must be a known {place} ({', '.join(sorted(known))}). Try `{near}`.")


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The entries of nested dictionaries by their dotted names."""
    if not isinstance(value, Mapping):
        yield name, value
        return
    for key, entry in value.items():
        yield from _flat(f"{name}.{key}", entry)


@cache
def _groups() -> set[str]:
    """The groups of ``conf`` that ``conf/train.yaml`` chooses from."""
    defaults = OmegaConf.to_container(OmegaConf.load(CONF / "train.yaml"))["defaults"]  # type: ignore[call-overload, index]
    return {name for entry in defaults if isinstance(entry, dict) for name in entry if "@" not in name}


@cache
def _variants(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))
