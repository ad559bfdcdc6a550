"""Piecewise cubic interpolation of values on a lattice, with gradients."""

from __future__ import annotations

from math import prod

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.grid import Lattice

#: Number of points interpolated at once; each gathers 4^d rows.
_CHUNK = 1 << 13


class Interpolant:
    """A continuously differentiable interpolant of values on a lattice: tensor products of Catmull-Rom cubics.

    It reproduces linear functions everywhere, and quadratic functions away from the faces of the box. Outside the
    lattice it is constant in the outward direction, with zero gradient.

    Args:
        lattice: The lattice, with at least 2 points along each axis.
        values: Values at the points of the lattice, shape (number of points, m), the last axis fastest.

    Raises:
        ValueError: If the number of rows is not the number of points.

    References:
        Keys, Cubic Convolution Interpolation for Digital Image Processing, IEEE Transactions on Acoustics, Speech, and
        Signal Processing 1981. https://doi.org/10.1109/TASSP.1981.1163711
    """

    def __init__(self, lattice: Lattice, values: Float[Tensor, "k m"]) -> None:
        if len(values) != prod(lattice.shape):
            raise ValueError(
                f"`values` must have one row for each of {prod(lattice.shape)} points, got {len(values)} rows. Try "
                "`field(lattice.points(lattice.indices()))`."
            )
        self.lattice = lattice
        grid = values.view(*lattice.shape, -1)
        for axis, count in enumerate(lattice.shape):  # pad by one extrapolated layer
            first, second, last, before = (grid.narrow(axis, i, 1) for i in (0, 1, count - 1, count - 2))
            grid = torch.cat([2 * first - second, grid, 2 * last - before], axis)
        rows = grid.flatten(0, -2)
        # view four consecutive rows as one, because they are gathered together
        self._runs = rows.as_strided((len(rows) - 3, 4 * rows.shape[1]), (rows.shape[1], 1))

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n m"]:
        """Evaluate the interpolant at points of shape (n, d)."""
        return torch.cat([self._value(chunk) for chunk in x.split(_CHUNK)])

    def jet(self, x: Float[Tensor, "n d"]) -> tuple[Float[Tensor, "n m"], Float[Tensor, "n m d"]]:
        """Evaluate the interpolant and its Jacobian at points of shape (n, d)."""
        values, jacobians = zip(*(self._jet(chunk) for chunk in x.split(_CHUNK)), strict=True)
        return torch.cat(values), torch.cat(jacobians)

    def _value(self, x: Tensor) -> Tensor:
        rows, position, _ = self._around(x)
        weights = _products([_weights(u) for u in position.unbind(1)])
        return (weights[:, None] @ rows)[:, 0]

    def _jet(self, x: Tensor) -> tuple[Tensor, Tensor]:
        rows, position, inside = self._around(x)
        weights = [_weights(u) for u in position.unbind(1)]
        scales = (inside / self.lattice.step).unbind(1)
        slopes = [_slopes(u) * scale[:, None] for u, scale in zip(position.unbind(1), scales, strict=True)]
        along = [_products([*weights[:axis], slopes[axis], *weights[axis + 1 :]]) for axis in range(len(weights))]
        values = torch.stack([_products(weights), *along], 1) @ rows
        return values[:, 0], values[:, 1:].mT

    def _around(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Gather the rows around each point, its position in its cell, and whether it is inside along each axis.

        Returns:
            Rows, shape (n, 4^d, m); positions in [0, 1], shape (n, d); and flags, shape (n, d).
        """
        shape = self.lattice.shape
        last = torch.tensor(shape, device=x.device) - 1
        coordinate = (x - self.lattice.origin) / self.lattice.step
        inside = (coordinate >= 0) & (coordinate <= last)
        coordinate = torch.minimum(coordinate.clamp(min=0), last)
        cell = torch.minimum(coordinate.detach().long(), last - 1)
        index = torch.zeros(len(x), 1, dtype=torch.long, device=x.device)
        for axis, count in enumerate(shape[:-1]):
            around = cell[:, axis, None] + torch.arange(4, device=x.device)
            index = (index[:, :, None] * (count + 2) + around[:, None]).flatten(1)
        index = index * (shape[-1] + 2) + cell[:, -1:]
        rows = torch.index_select(self._runs, 0, index.flatten())
        return rows.view(len(x), 4 ** len(shape), rows.shape[1] // 4), coordinate - cell, inside


def _products(weights: list[Tensor]) -> Float[Tensor, "n k"]:
    """Multiply weights along each axis, shape (n, 4), to those of the 4^d points around."""
    product = weights[0]
    for along in weights[1:]:
        product = (product[:, :, None] * along[:, None]).flatten(1)
    return product


def _weights(u: Float[Tensor, " n"]) -> Float[Tensor, "n 4"]:
    """Weights of the samples at −1, 0, 1, and 2 for an interpolated value at u in [0, 1]."""
    square, cube = u * u, u * u * u
    before, start = -cube / 2 + square - u / 2, 1.5 * cube - 2.5 * square + 1
    return torch.stack([before, start, -1.5 * cube + 2 * square + u / 2, cube / 2 - square / 2], 1)


def _slopes(u: Float[Tensor, " n"]) -> Float[Tensor, "n 4"]:
    """Derivatives of these weights."""
    square = u * u
    before, start = -1.5 * square + 2 * u - 0.5, 4.5 * square - 5 * u
    return torch.stack([before, start, -4.5 * square + 4 * u + 0.5, 1.5 * square - u], 1)
