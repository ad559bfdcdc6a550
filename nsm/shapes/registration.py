"""Registration: the similarity that lays one surface on another, found from any initial position.

With φ_S and φ_T the signed distances of two shapes S and T, the similarity A (x ↦ s R x + t) minimizes

    Σ_i ρ(φ_S(A x_i)) + Σ_j ρ(s φ_T(A⁻¹ y_j)),

where the points x_i and y_j are drawn by area on the surfaces of T and S. Both directions count, so that laying one
shape on a part of the other has its cost. The kernel ρ(r) = r² / (r² + σ²) of Geman and McClure is bounded, so that
what only one of the shapes has, such as the missing half of a partial scan, does not pull; σ follows the median of |r|.

The search is global. It starts from rotations that cover all of them and descends by Gauss-Newton steps in rounds,
from which fewer and fewer candidates go on with more and more points. The last rounds read the distances of the shapes
themselves in place of those on a coarse lattice, so that the residual of two copies of one shape vanishes.

References:
    Fitzgibbon, Robust registration of 2D and 3D point sets, 2003. https://doi.org/10.1016/j.imavis.2003.09.004
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.shapes.base import FieldShape
from nsm.shapes.normalized import NormalizedShape
from nsm.shapes.rotations import covering_rotations, rotation_angles
from nsm.shapes.similarity import Similarity

#: Candidates whose rotations differ by less than this angle, in degrees, count as one.
_DISTINCT = 15.0
#: Steps of all starts, points of each surface that they read, and how many distinct poses go on.
_START_STEPS, _START_POINTS, _STARTED = 15, 60, 100
#: Rounds on the lattice: how many distinct candidates go on, after how many steps, on how many points of each surface.
_ROUNDS = ((20, 12, 120), (5, 12, 240))
#: The same on the true distances.
_LAST_ROUNDS = ((2, 3, 200), (2, 4, 500))
#: Points drawn on each surface, of which the rounds take the first ones.
_POINTS = max(points for _, _, points in (*_ROUNDS, *_LAST_ROUNDS))
#: σ as a multiple of the median of |r|.
_SIGMA = 2.0
#: Least σ on the lattice (single precision) and on true distances, in root mean square radii of the source.
_LEAST_SIGMA = {torch.float32: 0.03, torch.float64: 1e-6}
#: Damping of the normal equations as a share of their mean diagonal, for motions that leave a symmetric shape alone.
_DAMPING = {torch.float32: 1e-3, torch.float64: 1e-6}
#: Longest step, in radians and in root mean square radii.
_LONGEST = 0.5
#: σ of the kernel by which candidates are compared, in root mean square radii of the source.
_COMPARED = 0.1

#: Signed distances (k, n) and their gradients (k, n, d) at points of shape (k, n, d), in normalized coordinates.
_Distances = Callable[[Tensor], tuple[Tensor, Tensor]]


class Candidate(NamedTuple):
    """A local minimum of the registration.

    Attributes:
        similarity: From the local coordinates of the target to those of the source.
        residual: Mean of |r| over the points of both surfaces, divided by the longest side of the source.
        cost: Mean of ρ(r) over the points of both surfaces with a fixed σ, from 0 where they coincide to 1.
    """

    similarity: Similarity
    residual: float
    cost: float


@torch.no_grad()
def register(
    source: FieldShape, target: FieldShape, start: Similarity, generators: Float[Tensor, "g d d"]
) -> list[Candidate]:
    """Find the similarities that lay a target on a source best.

    Args:
        source: Shape that stays where it is.
        target: Shape that is moved.
        start: Similarity from the local coordinates of the target to those of the source. Its scale is the initial
            one. Its rotation is one of many initial ones, which cover all rotations; its translation plays no part.
        generators: Matrices whose exponentials are the linear maps that may be applied to the target: those of the
            rotations (`nsm.shapes.rotations.rotation_generators`), and the identity if the scale is to be fitted.

    Returns:
        The best local minima with distinct rotations, best first; the one that descends from the rotation of ``start``;
        and the candidate that keeps this rotation.
    """
    generator = torch.Generator().manual_seed(0)
    bodies = NormalizedShape(source, _POINTS, generator), NormalizedShape(target, _POINTS, generator)
    first = bodies[0].normalizing.after(start).after(bodies[1].normalizing.inverse())
    turns = torch.cat([first.rotation[None], covering_rotations(source.dim)])
    starts = _Poses(first.scale * turns, torch.zeros(len(turns), source.dim, dtype=torch.float64))
    growth = generators.diagonal(dim1=1, dim2=2).mean(1)
    poses = _started(bodies, starts.in_single_precision(), generators[growth == 0])
    nearest = starts.chosen([0]).in_single_precision()
    for count, steps, points in _ROUNDS:
        problem = _on_lattice(bodies, points, generators)
        poses, nearest = problem.best(problem.descend(poses, steps), count), problem.descend(nearest, steps)
    poses, nearest, unturned = poses.in_double_precision(), nearest.in_double_precision(), starts.chosen([0])
    if not growth.any():  # single precision has changed the scale a little
        poses, nearest = poses.with_scale(first.scale), nearest.with_scale(first.scale)
    exact: list[_Distances] = [body.true_distance for body in bodies]
    for count, steps, points in _LAST_ROUNDS:
        problem = _Problem([body.points[:points] for body in bodies], exact, generators)
        poses, nearest = problem.best(problem.descend(poses, steps), count), problem.descend(nearest, steps)
        without_rotations = problem._replace(generators=growth[:, None, None] * generators)
        unturned = without_rotations.descend(unturned, steps)
    return [candidate for found in (poses, nearest, unturned) for candidate in _candidates(bodies, found, problem)]


class _Poses(NamedTuple):
    """Similarities x ↦ L x + t between normalized coordinates, with L = s R of shape (k, d, d) and t (k, d)."""

    linear: Tensor
    offset: Tensor

    @property
    def scales(self) -> Tensor:
        """Scales s, shape (k,)."""
        return self.linear.square().sum((1, 2)).div(self.linear.shape[1]).sqrt()

    @property
    def rotations(self) -> Tensor:
        """Rotations R, shape (k, d, d)."""
        return self.linear / self.scales[:, None, None]

    def chosen(self, rows: list[int]) -> _Poses:
        """Some of the poses."""
        return _Poses(self.linear[rows], self.offset[rows])

    def with_scale(self, scale: float) -> _Poses:
        """The same rotations and translations with another scale."""
        return _Poses(scale * self.rotations, self.offset)

    def in_single_precision(self) -> _Poses:
        """The same poses in single precision."""
        return _Poses(self.linear.float(), self.offset.float())

    def in_double_precision(self) -> _Poses:
        """The nearest similarities in double precision: rounding has made L no multiple of a rotation."""
        left, stretches, right = torch.linalg.svd(self.linear.double())
        return _Poses(stretches.mean(1)[:, None, None] * (left @ right), self.offset.double())


class _Problem(NamedTuple):
    """The sum to be minimized, on some points.

    Attributes:
        samples: Points on the surfaces of the source and of the target, which may be none.
        distances: Signed distances of the source and of the target with their gradients.
        generators: Of the linear maps that may be applied to the target.
    """

    samples: list[Tensor]
    distances: list[_Distances]
    generators: Tensor

    def descend(self, poses: _Poses, steps: int) -> _Poses:
        """Poses after some Gauss-Newton steps, each of which applies exponentials of the generators and a shift."""
        count = len(self.generators)
        for _ in range(steps):
            step = _gauss_newton(*self.linearized(poses))
            motion = torch.matrix_exp(torch.einsum("kg,gij->kij", step[:, :count], self.generators))
            shifted = torch.einsum("kij,kj->ki", motion, poses.offset) + step[:, count:]
            poses = _Poses(motion @ poses.linear, shifted)
        return poses

    def best(self, poses: _Poses, count: int) -> _Poses:
        """The best of the poses, best first, without those that turn the target like a better one."""
        rotations, chosen = poses.rotations, list[int]()
        for row in _costs(self.linearized(poses)[0]).argsort().tolist():
            if not chosen or rotation_angles(rotations[chosen].mT @ rotations[row]).min() > _DISTINCT:
                chosen.append(row)
            if len(chosen) == count:
                break
        return poses.chosen(chosen)

    def linearized(self, poses: _Poses) -> tuple[Float[Tensor, "k n"], Float[Tensor, "k n m"]]:
        """Residuals r, and their derivatives by the coefficients of the generators and the shift.

        As a point A y of the target moves by δy, s φ_T(A⁻¹ ·) changes by −⟨R ∇φ_T, δy⟩ + (δs / s) s φ_T.
        """
        scales, rotations = poses.scales, poses.rotations
        of_target = self.samples[1] @ poses.linear.mT + poses.offset[:, None]
        of_source = (self.samples[0] - poses.offset[:, None]) @ rotations / scales[:, None, None]
        to_source, source_gradients = self.distances[0](of_target)
        to_target, target_gradients = self.distances[1](of_source)
        to_target = scales[:, None] * to_target
        gradients = torch.cat([source_gradients, -target_gradients @ rotations.mT], 1)
        places = torch.cat([of_target, self.samples[0].expand_as(of_source)], 1)
        along = torch.einsum("kni,gij,knj->kng", gradients, self.generators, places)
        along[:, of_target.shape[1] :] += to_target[:, :, None] * self.generators.diagonal(dim1=1, dim2=2).mean(1)
        return torch.cat([to_source, to_target], 1), torch.cat([along, gradients], 2)


def _on_lattice(bodies: tuple[NormalizedShape, NormalizedShape], points: int, generators: Tensor) -> _Problem:
    """The problem with distances read from lattices, in single precision."""
    samples = [body.points[:points].float() for body in bodies]
    return _Problem(samples, [body.lattice_distance for body in bodies], generators.float())


def _started(bodies: tuple[NormalizedShape, NormalizedShape], starts: _Poses, rotations: Tensor) -> _Poses:
    """The best poses after a few steps by the residuals on both surfaces, and by those on either one.

    Those on one surface alone find the place of a partial shape on a whole one, from wherever it starts.
    """
    both = _on_lattice(bodies, _START_POINTS, rotations)
    source, target = both.samples
    problems = both, both._replace(samples=[source, target[:0]]), both._replace(samples=[source[:0], target])
    found = [problem.descend(starts, _START_STEPS) for problem in problems]
    return both.best(_Poses(*(torch.cat(parts) for parts in zip(*found, strict=True))), _STARTED)


def _gauss_newton(residuals: Float[Tensor, "k n"], jacobian: Float[Tensor, "k n m"]) -> Float[Tensor, "k m"]:
    """Step of iteratively reweighted least squares for Σ ρ(r), with ρ' / r = 2 σ² / (r² + σ²)²."""
    sigma = (_SIGMA * residuals.abs().median(1, keepdim=True).values).clamp(min=_LEAST_SIGMA[residuals.dtype])
    weights = (1 + (residuals / sigma).square()).pow(-2)
    weighted = weights[:, :, None] * jacobian
    normal = weighted.mT @ jacobian
    damping = _DAMPING[residuals.dtype] * normal.diagonal(dim1=1, dim2=2).mean(1)
    normal.diagonal(dim1=1, dim2=2).add_(damping[:, None])
    step = -torch.linalg.solve(normal, (weighted * residuals[:, :, None]).sum(1))
    return step * (_LONGEST / step.norm(dim=1, keepdim=True).clamp(min=_LONGEST))


def _costs(residuals: Float[Tensor, "k n"]) -> Float[Tensor, " k"]:
    """Mean of ρ(r) with the fixed σ."""
    squares = residuals.square()
    return (squares / (squares + _COMPARED**2)).mean(1)


def _candidates(bodies: tuple[NormalizedShape, NormalizedShape], poses: _Poses, problem: _Problem) -> list[Candidate]:
    """The outcome for each of the poses, in the local coordinates of both shapes."""
    source, target = bodies
    residuals, _ = problem.linearized(poses)
    found = poses.rotations, poses.offset, poses.scales.tolist(), residuals, _costs(residuals).tolist()
    return [
        Candidate(
            source.normalizing.inverse().after(Similarity(rotation, offset, scale)).after(target.normalizing),
            float(residual.abs().mean()) / source.side,
            cost,
        )
        for rotation, offset, scale, residual, cost in zip(*found, strict=True)
    ]
