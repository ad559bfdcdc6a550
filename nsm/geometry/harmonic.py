"""Harmonic functions in the shell between two nested surfaces, on a lattice."""

from __future__ import annotations

import logging
from itertools import product

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import bicgstab
from torch import Tensor

from nsm.geometry.grid import Lattice, evaluate, index_grid
from nsm.types import SignedDistance

log = logging.getLogger(__name__)

#: Cells that the lattice extends beyond the outer surface.
_MARGIN = 3
#: Points along an edge of the blocks that are tested for the shell before their points are.
_BLOCK = 8
#: Least distance of a point from a surface along an axis, in cells; nearer points count as on it.
_LEAST = 1e-3
#: Residual, relative to the right-hand side, at which the linear system counts as solved, and most iterations.
_TOLERANCE, _ITERATIONS = 1e-9, 5000
#: Number of times that gradients are extrapolated by one more layer of points.
_LAYERS = 3


class HarmonicGradient:
    """∇h of the function h with Δh = 0 between two surfaces, h = 0 on the inner and h = 1 on the outer one.

    h is found on the points of a lattice in the shell by finite differences of second order that end at the surfaces
    (Shortley and Weller), ∇h by differences of the same order. It is extrapolated past the surfaces and interpolated
    linearly between points. Where the shell is thinner than a cell, ∇h is that of g₀/(g₀ − g₁).

    Args:
        inner: Signed distance g₀ of the inner surface, which maps points (n, d) to values (n,).
        outer: Signed distance g₁ of the outer surface, which encloses the inner one.
        bounds: Corners of a box that contains the outer surface, shape (2, d).
        resolution: Number of cells along the longest edge of the box.

    References:
        Shortley and Weller, The Numerical Solution of Laplace's Equation, Journal of Applied Physics 1938.
        https://doi.org/10.1063/1.1710426
        Jones, Buchbinder, and Aharon, Three-dimensional mapping of cortical thickness using Laplace's equation, Human
        Brain Mapping 2000. https://doi.org/10.1002/1097-0193(200009)11:1<12::AID-HBM20>3.0.CO;2-K
    """

    def __init__(
        self, inner: SignedDistance, outer: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int
    ) -> None:
        cell = float((bounds[1] - bounds[0]).max()) / resolution
        pad = _MARGIN * cell
        padded = torch.stack([bounds[0] - pad, bounds[1] + pad]).double()
        self.lattice = Lattice.corners(padded, resolution + 2 * _MARGIN)
        self.index, g0, g1 = _around_shell(inner, outer, self.lattice)
        self._outer = g1
        self._slots = np.full(self.lattice.shape, -1, dtype=np.int64)
        self._slots[tuple(self.index.T)] = np.arange(len(self.index))
        self.steps = self.lattice.step.numpy()
        self._least = _LEAST * cell
        self.inside = (g0 > self._least) & (g1 < -self._least)
        sides = [self._sides(axis, g0, g1) for axis in range(self.index.shape[1])]
        self.values = _solved(sides, self.inside, self.steps, np.clip(_ratio(g0, g1), 0, 1))
        self.gradients = self._extended(sides, _ratio(g0, g1))

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Interpolate ∇h at points of the shell, shape (n, d); 0 far from it."""
        return self._interpolated(self.gradients, x)

    def to_outer(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Interpolate the signed distance g₁ at points of the shell, shape (n,); 0 far from it."""
        return self._interpolated(self._outer[:, None], x)[:, 0]

    def _interpolated(self, values: np.ndarray, x: Tensor) -> Tensor:
        position = (x.double().cpu() - self.lattice.origin).numpy() / self.steps
        cell = np.clip(np.floor(position).astype(np.int64), 0, np.array(self.lattice.shape) - 2)
        offset = np.clip(position - cell, 0, 1)
        total, weights = np.zeros((len(x), values.shape[1])), np.zeros(len(x))
        for corner in product((0, 1), repeat=x.shape[1]):
            slot = self._slots[tuple((cell + corner).T)]
            weight = np.where(slot >= 0, np.where(corner, offset, 1 - offset).prod(1), 0.0)
            total += weight[:, None] * values[slot]
            weights += weight
        return torch.from_numpy(total / np.maximum(weights, 1e-12)[:, None]).to(x)

    def _neighbors(self, axis: int, sign: int) -> np.ndarray:
        """Rows of the next points along an axis, shape (n,); −1 where there is none."""
        moved = self.index.copy()
        moved[:, axis] += sign
        there = (moved[:, axis] >= 0) & (moved[:, axis] < self.lattice.shape[axis])
        return np.where(there, self._slots[tuple(np.where(there[:, None], moved, 0).T)], -1)

    def _sides(self, axis: int, g0: np.ndarray, g1: np.ndarray) -> list[_Side]:
        """What lies before and after each point inside along an axis: another one, or a surface on the way to it."""
        sides = []
        here = g0[self.inside], g1[self.inside]
        for sign in (-1, 1):
            row = self._neighbors(axis, sign)[self.inside]
            share, value = np.ones(len(row)), np.full(len(row), np.nan)
            # a point without a neighbor lies at the rim, near one of the surfaces
            value[row < 0] = np.where(here[0] < -here[1], 0.0, 1.0)[row < 0]
            for level, g, beyond in ((0.0, g0, g0 <= self._least), (1.0, g1, g1 >= -self._least)):
                crossed = (row >= 0) & beyond[row]
                from_here = np.where(crossed, here[int(level)], 1.0)
                cut = np.clip(from_here / (from_here - np.where(crossed, g[row], 0.0)), _LEAST, 1)
                nearer = crossed & (np.isnan(value) | (cut < share))
                share, value = np.where(nearer, cut, share), np.where(nearer, level, value)
            sides.append(_Side(row, share * self.steps[axis], value))
        return sides

    def _extended(self, sides: list[list[_Side]], ratio: np.ndarray) -> np.ndarray:
        """Gradients at the points inside, and extrapolated to the others, shape (n, d)."""
        gradients = np.full(self.index.shape, np.nan)
        here = self.values[self.inside]
        for axis, (before, after) in enumerate(sides):
            left = (here - before.reached(self.values)) / before.length
            right = (after.reached(self.values) - here) / after.length
            along = (left * after.length + right * before.length) / (before.length + after.length)
            gradients[self.inside, axis] = along
        around = [(axis, sign) for axis in range(self.index.shape[1]) for sign in (-1, 1)]
        rows = [self._neighbors(axis, sign) for axis, sign in around]
        for _ in range(_LAYERS):
            total, count = np.zeros_like(gradients), np.zeros(len(gradients))
            for row in rows:
                first = np.where(row[:, None] >= 0, gradients[row], np.nan)
                following = np.where(row >= 0, row[row], -1)
                second = np.where(following[:, None] >= 0, gradients[following], np.nan)
                guess = 2 * first - second
                known = np.isfinite(guess).all(1)
                total[known] += guess[known]
                count += known
            fill = np.isnan(gradients).any(1) & (count > 0)
            gradients[fill] = total[fill] / count[fill, None]
        return np.where(np.isnan(gradients), self._differences(ratio), gradients)

    def _differences(self, ratio: np.ndarray) -> np.ndarray:
        """Central differences of values at all points, one-sided at the rim, shape (n, d)."""
        found = []
        for axis, step in enumerate(self.steps):
            before, after = self._neighbors(axis, -1), self._neighbors(axis, 1)
            left = np.where(before >= 0, ratio - ratio[before], 0)
            right = np.where(after >= 0, ratio[after] - ratio, 0)
            found.append((left + right) / np.maximum((before >= 0) + 1.0 * (after >= 0), 1) / step)
        return np.stack(found, 1)


class _Side:
    """Neighbors on one side of the points inside, along an axis.

    Args:
        row: Row of the next point of the lattice, shape (m,).
        length: Distance to it, or to the surface that lies before it, shape (m,).
        value: h on that surface; nan where there is none, shape (m,).
    """

    def __init__(self, row: np.ndarray, length: np.ndarray, value: np.ndarray) -> None:
        self.row, self.length, self.value = row, length, value

    def reached(self, values: np.ndarray) -> np.ndarray:
        """h at the neighbor or on the surface, shape (m,)."""
        return np.where(np.isnan(self.value), values[self.row], self.value)


def _around_shell(
    inner: SignedDistance, outer: SignedDistance, lattice: Lattice
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices (n, d) of the points of a lattice in and near the shell, and their distances g₀ and g₁, both (n,)."""
    dim = len(lattice.shape)
    blocks = index_grid(tuple(-(-n // _BLOCK) for n in lattice.shape), lattice.step.device)
    reach = 2 * float(lattice.step.norm())
    radius = _BLOCK / 2 * float(lattice.step.norm()) + reach
    centers = lattice.points(_BLOCK * blocks + (_BLOCK - 1) / 2)
    near = (evaluate(inner, centers).double() > -radius) & (evaluate(outer, centers).double() < radius)
    within = index_grid((_BLOCK,) * dim, lattice.step.device)
    index = (_BLOCK * blocks[near][:, None] + within).view(-1, dim)
    index = index[(index < torch.tensor(lattice.shape)).all(1)]
    x = lattice.points(index)
    g0, g1 = evaluate(inner, x).double(), evaluate(outer, x).double()
    kept = (g0 > -reach) & (g1 < reach)
    return index[kept].numpy(), g0[kept].numpy(), g1[kept].numpy()


def _ratio(g0: np.ndarray, g1: np.ndarray) -> np.ndarray:
    """g₀/(g₀ − g₁), which is 0 and 1 on the surfaces as h is."""
    return g0 / np.maximum(g0 - g1, 1e-9 * np.abs(g0 - g1).max(initial=1e-300))


def _solved(sides: list[list[_Side]], inside: np.ndarray, steps: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Solve Δh = 0 at the points inside; elsewhere the values are those of ``start``."""
    count = int(inside.sum())
    number = np.cumsum(inside) - 1
    diagonal, right = np.zeros(count), np.zeros(count)
    rows, columns, entries = [], [], []
    for (before, after), step in zip(sides, steps, strict=True):
        total = before.length + after.length
        for side in (before, after):
            weight = 2 * step**2 / (side.length * total)
            diagonal += weight
            free = np.isnan(side.value)
            right += np.where(free, 0.0, weight * np.nan_to_num(side.value))
            rows.append(np.flatnonzero(free))
            columns.append(number[side.row[free]])
            entries.append(weight[free])
    scale = 1 / diagonal
    matrix = csr_matrix(
        (-np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count)
    )
    system = diags(scale) @ matrix + diags(np.ones(count))
    found, failed = bicgstab(system, scale * right, x0=start[inside], rtol=_TOLERANCE, maxiter=_ITERATIONS)
    if failed:
        log.warning("Laplace's equation between the surfaces was not solved to %g in %d steps", _TOLERANCE, _ITERATIONS)
    values = start.copy()
    values[inside] = found
    return values
