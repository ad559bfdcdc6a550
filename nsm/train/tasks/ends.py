"""Preparation of the end shapes: fields of the same dimension and volume, placed together in the box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nsm.cli.errors import InputError
from nsm.fields import ScalarSiren
from nsm.shapes import Alignment, FieldShape, Shape, SirenShape, Unaligned, equal_volume, place_together
from nsm.train.tasks.fit import SdfFit, realize

#: Leaves shapes where their poses put them.
UNALIGNED = Unaligned()


@dataclass(frozen=True)
class Ends:
    """End shapes of a morph.

    Attributes:
        source: Posed and scaled field at t = 0.
        target: Posed and scaled field at t = 1.
        provenance: Origin of each shape, its similarity to the box, and the factor by which it was scaled for equal
            volumes (1 for the smaller shape), as plain values; for the target also its ``alignment``, which says how it
            was moved to the source.
    """

    source: FieldShape
    target: FieldShape
    provenance: dict[str, Any]


def prepare_ends(source: Shape, target: Shape, fit: SdfFit, equal: bool = True, align: Alignment = UNALIGNED) -> Ends:
    """Fit networks to shapes that are not fields yet, align them, make the volumes equal, and place both in the box.

    Args:
        source: Shape at t = 0.
        target: Shape at t = 1.
        fit: Recipe that fits a network to a shape.
        equal: Whether to make the volumes equal.
        align: Moves the target to the source, before the volumes are made equal.

    Raises:
        InputError: If the dimensions differ.
    """
    if source.dim != target.dim:
        raise InputError(
            f"`shape@target` must have the dimension of the source, {source.dim}D, got a shape in {target.dim}D. "
            f"Try `shape@target={'torus' if source.dim == 3 else 'square'}`."
        )
    fields = [realize(shape, fit) for shape in (source, target)]
    for field in fields:
        if isinstance(field, SirenShape):
            field.log_deviation()
    aligned = align(*fields)
    fields, scales = [fields[0], aligned.target], [1.0, 1.0]
    if equal:
        result = equal_volume(*fields)
        fields, scales = [result.source, result.target], [result.source_scale, result.target_scale]
    pair = place_together(*fields)
    provenance = {
        end: {**field.provenance(), "scale": scale}
        for end, field, scale in zip(("source", "target"), (pair.source, pair.target), scales, strict=True)
    }
    provenance["target"]["alignment"] = aligned.provenance
    return Ends(pair.source, pair.target, provenance)


def starting_network(field: ScalarSiren, source: FieldShape, fit: SdfFit) -> ScalarSiren:
    """Return a network of the size of f that represents the source in the whole training box.

    That is the network of the source itself if it was trained in the whole box, and otherwise one fitted to the true
    distances of the source.

    Args:
        field: Network of f, whose size is required.
        source: Shape at t = 0.
        fit: Recipe that fits a network to a shape.

    Raises:
        InputError: If the recipe makes a network of another size.
    """
    if isinstance(source, SirenShape) and _size(source.network) == _size(field) and source.covers(fit.half_width):
        return source.folded()
    fitted = fit(source).folded()
    if _size(fitted) != _size(field):
        raise InputError(
            f"`sdf.network` must have the size of `network.field`, {_size(field)} hidden features and layers, got "
            f"{_size(fitted)}. Try `init=siren`, which does not start f from the source."
        )
    return fitted


def _size(network: ScalarSiren) -> tuple[int, int]:
    return network.hidden_features, network.hidden_layers
