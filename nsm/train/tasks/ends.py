"""The two ends of a morph: fields of one dimension, placed together and, if wanted, of one volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nsm.cli.errors import InputError
from nsm.fields import ScalarSiren
from nsm.shapes import FieldShape, Shape, SirenShape, equal_volume, place_together
from nsm.train.tasks.fit import SdfFit, realise


@dataclass(frozen=True)
class Ends:
    """The end shapes as a morph takes them.

    Attributes:
        source, target: posed and scaled fields.
        provenance: where each comes from with its similarity to the box, and the factor by which it was scaled to make
            the volumes equal (1 for the smaller shape), as plain values.
    """

    source: FieldShape
    target: FieldShape
    provenance: dict[str, Any]


def prepare_ends(source: Shape, target: Shape, fit: SdfFit, equal: bool = True) -> Ends:
    """Fit networks where a shape is no field yet, make the volumes equal, and place both together in the box.

    Args:
        source, target: any shapes.
        fit: makes networks of points.
        equal: whether to make the volumes equal.

    Raises:
        InputError: if the shapes differ in dimension.
    """
    if source.dim != target.dim:
        raise InputError(
            f"the source is {source.dim}D and the target {target.dim}D: name two shapes of the same dimension"
        )
    fields = [realise(shape, fit) for shape in (source, target)]
    for field in fields:
        if isinstance(field, SirenShape):
            field.log_deviation()
    scales = [1.0, 1.0]
    if equal:
        result = equal_volume(*fields)
        fields, scales = [result.source, result.target], [result.source_scale, result.target_scale]
    pair = place_together(*fields)
    provenance = {
        end: {**field.provenance(), "scale": scale}
        for end, field, scale in zip(("source", "target"), (pair.source, pair.target), scales, strict=True)
    }
    return Ends(pair.source, pair.target, provenance)


def starting_network(field: ScalarSiren, source: FieldShape, fit: SdfFit) -> ScalarSiren:
    """A network of the width and depth of f that is the source in all of the box that f is trained in.

    It is the source's own network where that was trained in all of the box, else one fitted to its true distances.
    """
    if isinstance(source, SirenShape) and _size(source.network) == _size(field) and source.covers(fit.half_width):
        return source.folded()
    fitted = fit(source).folded()
    if _size(fitted) != _size(field):
        raise InputError(
            f"init starts f from the source, but sdf.network has {_size(fitted)} hidden features and layers and "
            f"network.field {_size(field)}: make them the same, or choose init=siren"
        )
    return fitted


def _size(network: ScalarSiren) -> tuple[int, int]:
    return network.hidden_features, network.hidden_layers
