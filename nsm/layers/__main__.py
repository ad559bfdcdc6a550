"""``python -m nsm.layers``: surfaces that divide the shell between two nested surfaces into layers of equal volume."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

import nsm
from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.progress import Progress
from nsm.cli.settings import between, choice, increasing, use_threads, whole_number
from nsm.geometry.layers import equal_volume_surfaces
from nsm.geometry.topology import enclosed_volume
from nsm.io.mesh import write_mesh
from nsm.io.shape_file import read_shape
from nsm.shapes import FieldShape
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)

#: Mesh files by dimension; the first is the default.
FORMATS = {2: ("obj",), 3: ("ply", "obj", "stl")}
#: File beside the surfaces that describes them.
RECORD = "layers.json"
#: Share of the inner surface outside of the outer one above which the surfaces are not nested.
_NESTED = 0.1


def main(cfg: DictConfig) -> None:
    """Read two surfaces, and write those that divide the shell between them."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    fractions = _fractions(config["layers"])
    use_threads(config)
    inner, outer = (_surface(config, side) for side in ("inner", "outer"))
    if inner.dim != outer.dim:
        raise InputError(
            f"`outer` must have as many dimensions as `inner`, {inner.dim}, got {outer.dim}. Try two meshes."
        )
    known = FORMATS[inner.dim]
    suffix = known[0] if config["format"] is None else choice("format", config["format"], known)
    mesh = inner.surface()
    mesh = SimplexMesh(mesh.vertices.double(), mesh.simplices)
    _require_nested(mesh, outer)
    with Progress("solving Laplace's equation") as progress:

        def show(done: int, total: int) -> None:
            progress.update(done, total, "tracing columns" if done else None)

        surfaces = equal_volume_surfaces(
            mesh, inner, outer, outer.exact_bounds(), [*fractions, 1.0], config["resolution"], show
        )
    folder = Path(config["output"]) if config["output"] else Path("outputs") / "layers" / Path(config["inner"]).stem
    surfaces.insert(0, mesh)
    volumes = [enclosed_volume(surface) for surface in surfaces]
    shares = [(volume - volumes[0]) / (volumes[-1] - volumes[0]) for volume in volumes]
    records = []
    for number, (fraction, surface) in enumerate(zip([0.0, *fractions, 1.0], surfaces, strict=True)):
        name = f"surface_{number:04d}.{suffix}"
        write_mesh(folder / name, surface)
        records.append({"file": name, "fraction": fraction, "volume": volumes[number], "share": shares[number]})
    _write_record(folder / RECORD, config, records)
    off = max(abs(share - fraction) for share, fraction in zip(shares, [0.0, *fractions, 1.0], strict=True))
    log.info("volumes below the surfaces differ from the fractions by at most %.2g %% of the shell", 100 * off)
    log.info("wrote %d surfaces and the two of the shell to %s", len(fractions), folder)


def _fractions(value: Any) -> list[float]:
    """The setting ``layers``: a number of layers, or fractions of the volume of the shell below each surface."""
    if not isinstance(value, list):
        count = whole_number("layers", value, 2, 4)
        return [layer / count for layer in range(1, count)]
    if not value:
        raise InputError("`layers` must be a number of layers or a list of fractions, got []. Try `layers=4`.")
    return [between("layers", fraction, 0, 1, 0.5) for fraction in increasing("layers", value, "[0.1,0.5]")]


def _surface(config: dict[str, Any], side: str) -> FieldShape:
    """Read a surface in the coordinates of its file."""
    path, label = config[side], config[f"{side}_label"]
    if path is None:
        raise InputError(
            f"`{side}` must be the file of a surface, got nothing. Try `nsm layers inner=white.ply outer=pial.ply`."
        )
    shape = read_shape(str(path), fit=None, label=label)
    if not isinstance(shape, FieldShape):
        raise InputError(
            f"`{side}` must be a mesh, a volume of labels, or a silhouette, got {path}, which holds points. Try "
            f"`nsm train task=sdf shape@source=points source.path={path}`, and its folder as `{side}`."
        )
    return shape


def _require_nested(mesh: SimplexMesh, outer: FieldShape) -> None:
    """Refuse surfaces that are not nested, and warn where they touch: columns have no length there."""
    outside = float((outer(mesh.vertices) >= 0).double().mean())
    if outside > _NESTED:
        raise InputError(
            f"`outer` must enclose `inner`, got an inner surface of which {100 * outside:.3g} % lie outside of the "
            "outer one. Try the two the other way round."
        )
    if outside:
        log.warning(
            "%.2g %% of the inner surface touch the outer one; the layers have no thickness there", 100 * outside
        )


def _write_record(path: Path, config: dict[str, Any], records: Sequence[dict[str, Any]]) -> None:
    names = ("inner", "inner_label", "outer", "outer_label", "resolution")
    content = {"nsm": nsm.__version__, **{name: config[name] for name in names}, "surfaces": records}
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    entry.run(main, "layers")
