"""Preparation of the shapes of a morph: fields of the same dimension and volume, placed together in the box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nsm.cli.errors import InputError
from nsm.fields import ScalarSiren
from nsm.morphs.neural import key_times
from nsm.shapes import Alignment, FieldShape, Shape, SirenShape, Unaligned, equal_volume, place_together
from nsm.train.tasks.fit import SdfFit, realize
from nsm.types import Key

#: Leaves shapes where their poses put them.
UNALIGNED = Unaligned()


@dataclass(frozen=True)
class Keys:
    """Shapes that a morph passes through.

    Attributes:
        keys: Posed and scaled fields with their times, in order of time.
        provenance: Under ``source``, ``target``, and in the list ``between``: origin of each shape, its similarity to
            the box, the factor by which it was scaled for equal volumes (1 for the smallest), and, except for the
            source, its ``alignment``, which says how it was moved to the source; all as plain values.
    """

    keys: tuple[Key[FieldShape], ...]
    provenance: dict[str, Any]

    @property
    def source(self) -> FieldShape:
        """Shape at t = 0."""
        return self.keys[0].shape

    @property
    def target(self) -> FieldShape:
        """Shape at t = 1."""
        return self.keys[-1].shape


def prepare_keys(
    shapes: Sequence[Shape],
    fit: SdfFit,
    equal: bool = True,
    align: Alignment = UNALIGNED,
    times: Sequence[float] | None = None,
) -> Keys:
    """Fit networks to shapes that are not fields yet, align them, make the volumes equal, and place all in the box.

    Args:
        shapes: Source, shapes between, and target.
        fit: Recipe that fits a network to a shape.
        equal: Whether to make the volumes equal.
        align: Moves each of the others to the source, before the volumes are made equal.
        times: Times of the shapes, from 0 to 1; None for evenly spaced ones.

    Raises:
        InputError: If the dimensions differ, or the times do not fit the shapes.
    """
    moments = key_times(times, len(shapes))
    first = shapes[0]
    for shape in shapes[1:]:
        if shape.dim != first.dim:
            raise InputError(
                f"`shape@target` must have the dimension of the source, {first.dim}D, got a shape "
                f"in {shape.dim}D. Try `shape@target={'torus' if first.dim == 3 else 'square'}`."
            )
    fields = [realize(shape, fit) for shape in shapes]
    for field in fields:
        if isinstance(field, SirenShape):
            field.log_deviation()
    aligned = [align(fields[0], field) for field in fields[1:]]
    moved, scales = (fields[0], *(each.target for each in aligned)), (1.0,) * len(fields)
    if equal:
        moved, scales, _ = equal_volume(*moved)
    placed = place_together(*moved).shapes
    origins = [{**field.provenance(), "scale": scale} for field, scale in zip(placed, scales, strict=True)]
    for origin, each in zip(origins[1:], aligned, strict=True):
        origin["alignment"] = each.provenance
    provenance = {"source": origins[0], "target": origins[-1], "between": origins[1:-1]}
    return Keys(tuple(map(Key, moments, placed)), provenance)


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
