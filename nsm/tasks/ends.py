"""The two ends of a morph: fields of one dimension and, if wanted, of one volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nsm.errors import InputError
from nsm.fields import ScalarSiren
from nsm.shapes import FieldShape, Shape, equal_volume
from nsm.tasks.fit import SdfFit, realise


@dataclass(frozen=True)
class Ends:
    """The end shapes as a morph takes them.

    Attributes:
        source, target: posed and scaled fields.
        provenance: where each comes from, and the factor by which it was scaled about the origin, as plain values.
    """

    source: FieldShape
    target: FieldShape
    provenance: dict[str, Any]


def prepare_ends(source: Shape, target: Shape, fit: SdfFit, equal: bool = True) -> Ends:
    """Fit networks where a shape is no field yet, and scale the larger down to the volume of the smaller.

    Args:
        source, target: any shapes.
        fit: makes networks of meshes and points.
        equal: whether to make the volumes equal.

    Raises:
        InputError: if the shapes differ in dimension.
    """
    if source.dim != target.dim:
        raise InputError(
            f"the source is {source.dim}D and the target {target.dim}D: name two shapes of the same dimension"
        )
    fields = [realise(shape, fit) for shape in (source, target)]
    scales = [1.0, 1.0]
    if equal:
        result = equal_volume(*fields)
        fields, scales = [result.source, result.target], [result.source_scale, result.target_scale]
    provenance = {
        end: {**field.provenance(), "scale": scale}
        for end, field, scale in zip(("source", "target"), fields, scales, strict=True)
    }
    return Ends(fields[0], fields[1], provenance)


def starting_network(field: ScalarSiren, source: FieldShape, fit: SdfFit) -> ScalarSiren:
    """A network of the width and depth of f that is the source: the source itself if it is one, else fitted to it."""
    network = getattr(source, "network", None)
    if isinstance(network, ScalarSiren) and _size(network) == _size(field):
        return network
    fitted = fit(source).network
    if _size(fitted) != _size(field):
        raise InputError(
            f"init starts f from the source, but sdf.network has {_size(fitted)} hidden features and layers and "
            f"network.field {_size(field)}: make them the same, or choose init=siren"
        )
    return fitted


def _size(network: ScalarSiren) -> tuple[int, int]:
    return network.hidden_features, network.hidden_layers
