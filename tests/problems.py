"""Motions whose quantities are all known exactly, against which every numerical claim is tested.

Each is a `nsm.types.Morph` that also knows ∂f/∂t, the Jacobian of V, and the volume at any time. The level set
equation ∂f/∂t + ⟨∇f, V⟩ = 0 holds everywhere, not only on the surface.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.types import Jet, Morph, Times


class Ball:
    """The exact signed distance of a ball (disk in 2D) at the origin."""

    def __init__(self, dim: int, radius: float = 0.4) -> None:
        self.dim, self.radius = dim, radius
        self.volume = math.pi ** (dim / 2) / math.gamma(dim / 2 + 1) * radius**dim

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Value (n,) and gradient (n, d)."""
        norm = x.norm(dim=1)
        return Jet(norm - self.radius, x / norm[:, None])


class Box:
    """The exact signed distance of a box (rectangle in 2D) at the origin, with half its edges given."""

    def __init__(self, half: tuple[float, ...]) -> None:
        self.dim, self.half = len(half), half
        self.volume = math.prod(2 * h for h in half)

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Value (n,) and gradient (n, d)."""
        beyond = x.abs() - x.new_tensor(self.half)
        outside = beyond.clamp(min=0)
        far = outside.norm(dim=1)
        deepest = torch.nn.functional.one_hot(beyond.argmax(1), self.dim).to(x)
        direction = torch.where((far > 0)[:, None], outside / far.clamp(min=1e-300)[:, None], deepest)
        return Jet(far + beyond.amax(1).clamp(max=0), direction * torch.where(x < 0, -1.0, 1.0).to(x))


class ExactMotion(Morph):
    """A `Morph` in [-1, 1]^d whose quantities are all known."""

    #: Whether ‖∇f‖ = 1 almost everywhere at all times.
    is_distance = True

    def __init__(self, dim: int, dtype: torch.dtype = torch.float64) -> None:
        self.dim = dim
        self.bounds = torch.tensor([[-1.0] * dim, [1.0] * dim], dtype=dtype)
        self.source, self.target = partial(self.__call__, t=0.0), partial(self.__call__, t=1.0)
        self.provenance = {}

    @property
    def has_velocity(self) -> bool:
        return True

    @abstractmethod
    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """V(x, t)."""

    @abstractmethod
    def velocity_jacobian(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d d"]:
        """∂V_i/∂x_j (x, t)."""

    @abstractmethod
    def volume(self, t: float) -> float:
        """Volume of {f(·, t) < 0}."""

    def rate(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """∂f/∂t, by the level set equation."""
        return -(self.gradient(x, t) * self.velocity(x, t)).sum(1)

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """div V."""
        return self.velocity_jacobian(x, t).diagonal(dim1=1, dim2=2).sum(1)


class LinearMotion(ExactMotion):
    """A shape advected by V = M (x - c(t)) + v, with c(t) = start + v t: f(x, t) = f_0(exp(-M t) (x - c(t))).

    M antisymmetric is a rotation, traceless a squash that keeps volume, a multiple of 1 a growth. The volume is
    exp(t tr M) times that at the start.
    """

    def __init__(
        self,
        shape: Ball | Box,
        matrix: list[list[float]] | None = None,
        drift: list[float] | None = None,
        start: list[float] | None = None,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__(shape.dim, dtype)
        zero = [0.0] * shape.dim
        self.shape = shape
        self.matrix = torch.tensor(matrix or [zero] * shape.dim, dtype=dtype)
        self.drift = torch.tensor(drift or zero, dtype=dtype)
        self.start = torch.tensor(start or zero, dtype=dtype)
        self.is_distance = bool((self.matrix == -self.matrix.T).all())

    def _time(self, x: Tensor, t: Times) -> Tensor:
        return torch.as_tensor(t, dtype=x.dtype).expand(len(x))[:, None]

    def _centered(self, x: Tensor, t: Times) -> Tensor:
        return x - self.start - self._time(x, t) * self.drift

    def _back(self, x: Tensor, t: Times) -> tuple[Tensor, Tensor]:
        """Positions of the points at t = 0, and their Jacobian."""
        inverse = torch.matrix_exp(-self._time(x, t)[:, :, None] * self.matrix)
        return (inverse @ self._centered(x, t)[:, :, None])[:, :, 0], inverse

    def __call__(self, x: Tensor, t: Times) -> Tensor:
        return self.shape.jet(self._back(x, t)[0]).value

    def gradient(self, x: Tensor, t: Times) -> Tensor:
        origin, inverse = self._back(x, t)
        return (inverse.mT @ self.shape.jet(origin).gradient[:, :, None])[:, :, 0]

    def velocity(self, x: Tensor, t: Times) -> Tensor:
        return self._centered(x, t) @ self.matrix.T + self.drift

    def velocity_jacobian(self, x: Tensor, t: Times) -> Tensor:
        return self.matrix.expand(len(x), -1, -1)

    def volume(self, t: float) -> float:
        return self.shape.volume * math.exp(t * float(self.matrix.trace()))


class GrowingBall(ExactMotion):
    """A ball whose radius is r + g t, advected by V = g x/|x|: a distance at all times, div V = g (d - 1)/|x|."""

    def __init__(self, dim: int, radius: float = 0.4, growth: float = 0.3, dtype: torch.dtype = torch.float64) -> None:
        super().__init__(dim, dtype)
        self.radius, self.growth = radius, growth

    def __call__(self, x: Tensor, t: Times) -> Tensor:
        return x.norm(dim=1) - self.radius - self.growth * t

    def gradient(self, x: Tensor, t: Times) -> Tensor:
        return x / x.norm(dim=1, keepdim=True)

    def velocity(self, x: Tensor, t: Times) -> Tensor:
        return self.growth * self.gradient(x, t)

    def velocity_jacobian(self, x: Tensor, t: Times) -> Tensor:
        norm, normal = x.norm(dim=1)[:, None, None], self.gradient(x, t)
        return self.growth / norm * (torch.eye(self.dim, dtype=x.dtype) - normal[:, :, None] * normal[:, None, :])

    def volume(self, t: float) -> float:
        return Ball(self.dim, self.radius + self.growth * t).volume


def translating_ball(dim: int, dtype: torch.dtype = torch.float64) -> LinearMotion:
    """A ball that crosses the box."""
    return LinearMotion(Ball(dim), drift=[0.6, 0.3, -0.2][:dim], start=[-0.3, -0.15, 0.1][:dim], dtype=dtype)


def rotating_box(dim: int, dtype: torch.dtype = torch.float64) -> LinearMotion:
    """A box that rotates by about a radian."""
    spin = [[0.0, -0.9, 0.3], [0.9, 0.0, -0.5], [-0.3, 0.5, 0.0]]
    return LinearMotion(Box((0.55, 0.3, 0.4)[:dim]), matrix=[row[:dim] for row in spin[:dim]], dtype=dtype)


def squashed_box(dim: int, dtype: torch.dtype = torch.float64) -> LinearMotion:
    """A box that becomes flat and wide at constant volume; f is not a distance on the way."""
    stretch = [0.5, -0.5] if dim == 2 else [0.4, -0.7, 0.3]
    matrix = [[s if i == j else 0.0 for j in range(dim)] for i, s in enumerate(stretch)]
    return LinearMotion(Box((0.4, 0.5, 0.45)[:dim]), matrix=matrix, dtype=dtype)


def squashed_ball(dim: int, dtype: torch.dtype = torch.float64) -> LinearMotion:
    """A drifting ball that becomes an ellipsoid of the same volume; f is not a distance on the way."""
    matrix = [[0.0] * dim for _ in range(dim)]
    matrix[0][1] = matrix[1][0] = 0.5
    return LinearMotion(Ball(dim), matrix=matrix, drift=[0.2, 0.1, 0.1][:dim], start=[-0.1] * dim, dtype=dtype)


def growing_ball(dim: int, dtype: torch.dtype = torch.float64) -> GrowingBall:
    """A ball whose volume grows."""
    return GrowingBall(dim, dtype=dtype)


#: Every motion by name, to be called with a dimension (2 or 3).
MOTIONS = {
    motion.__name__: motion for motion in (translating_ball, rotating_box, squashed_box, squashed_ball, growing_ball)
}


def trajectory(motion: LinearMotion | GrowingBall, x: Tensor, t: float) -> Tensor:
    """Positions at time t of points that are at x at time 0."""
    if isinstance(motion, GrowingBall):
        return x + t * motion.growth * x / x.norm(dim=1, keepdim=True)
    return (x - motion.start) @ torch.matrix_exp(t * motion.matrix).T + motion.start + t * motion.drift
