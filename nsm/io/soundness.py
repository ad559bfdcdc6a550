"""Soundness of a model that a file describes, before and after it is built."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes import FieldShape
from nsm.shapes.simplices import SimplexShape
from nsm.types import Morph

#: Sizes up to which a model may be built that has fewer weights, such as one between two formulas.
_FEWEST = 4096


def require_size(node: Any, weights: Mapping[str, Tensor]) -> None:
    """Require that no size in the description of a model exceeds the number of its weights, before it is built.

    Args:
        node: Nested ``_target_`` configs.
        weights: Weights by name.

    Raises:
        InputError: If a size does not fit the weights.
    """
    values = sum(value.numel() for value in weights.values())
    for part in _groups(node):
        sizes = {key: value for key, value in part.items() if type(value) is int}
        width, depth = sizes.get("hidden_features", 1), sizes.get("hidden_layers", 1)
        layers = width * max(width * (depth - 1), sizes.get("in_features", 1))
        largest = max([layers, *(value for key, value in sizes.items() if key != "dim")], default=0)
        if largest > max(values, _FEWEST) or depth > len(weights) or sizes.get("dim", 2) not in (2, 3):
            raise InputError(
                f"`model` must have sizes that fit its {values} weights, got {sizes}. Try another checkpoint."
            )


def _groups(node: Any) -> Iterator[Mapping[str, Any]]:
    """All groups of arguments in nested ``_target_`` configs, but for the origin of shapes, which is only told."""
    if isinstance(node, Mapping):
        yield node
        for key, value in node.items():
            yield from () if key == "origin" else _groups(value)
    elif isinstance(node, list):
        for value in node:
            yield from _groups(value)


@torch.no_grad()
def require_working(model: Any) -> None:
    """Require that a model and its end shapes can be evaluated, which parts of the wrong kind cannot.

    Raises:
        ValueError: If they have another kind or dimension, or their fields are not finite.
    """
    shapes = [key.shape for key in model.keys] if isinstance(model, Morph) else [model]
    if any(not isinstance(shape, FieldShape) or shape.dim != model.dim for shape in shapes):
        raise ValueError("its ends are no shapes of its dimension")
    x = model.bounds if isinstance(model, Morph) else torch.zeros(2, model.dim)
    # those with simplices need a search tree, and have required sound simplices
    found = [shape(x) for shape in shapes if not isinstance(shape, SimplexShape)]
    if isinstance(model, Morph):
        found += [model(x, 0.5), model.gradient(x, 0.5)]
        found += [model.velocity(x, 0.5)] if model.has_velocity else []
    if not all(bool(value.isfinite().all()) for value in found):
        raise ValueError("its fields are not finite at corners of the box")
