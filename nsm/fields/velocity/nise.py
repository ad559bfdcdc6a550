"""The velocity of neural implicit surface evolution."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.velocity.base import Velocity
from nsm.types import Jet, Key, SignedDistance


class Nise(Velocity):
    """Motion along the normals until f equals the target, V = −s e^{−γ f²} (g₁ − f) ∇f/‖∇f‖ (paper, eq. 3).

    The velocity has no parameters of its own, so its gradient flows into f. The original method has s = 1 and γ = 0;
    the authors of the volume-preserving paper compare with s = ½ and γ = 1. Call `attach` before the first evaluation.

    Args:
        dim: Dimension d of space.
        scale: Factor s of the speed.
        decay: Rate γ at which the speed decays away from the surface, in 1/length².

    References:
        Novello et al., Neural Implicit Surface Evolution, ICCV 2023. https://arxiv.org/abs/2201.09636

    Example:
        >>> import torch
        >>> from nsm.fields import Nise, ScalarSiren
        >>> from nsm.shapes import Ball
        >>> from nsm.types import Key
        >>> field = ScalarSiren(in_features=4, hidden_features=16, hidden_layers=2)
        >>> velocity = Nise(dim=3)
        >>> velocity.attach(field, [Key(0.0, Ball(radius=0.4)), Key(1.0, Ball(radius=0.5))])
        >>> p = torch.rand(5, 4)
        >>> velocity(p, field.jet(p)).shape
        torch.Size([5, 3])
    """

    def __init__(self, dim: int, scale: float = 1.0, decay: float = 0.0) -> None:
        super().__init__(dim)
        self.scale, self.decay = float(scale), float(decay)
        # a tuple hides f from nn.Module: its parameters belong to the morph
        self._attached: tuple[ScalarNetwork, SignedDistance] | None = None

    def attach(self, field: ScalarNetwork, keys: Sequence[Key[SignedDistance]]) -> None:
        if len(keys) > 2:
            raise InputError(
                f"`between` must be empty for a velocity that leads straight to the target, got {len(keys) - 2} shapes "
                "between. Try `method=adadiv`."
            )
        self._attached = (field, keys[-1].shape)

    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        gradient = f.gradient[:, : self.dim]
        speed = self._weight(f.value) * self._difference(p, f.value)
        return -speed[:, None] * gradient / _length(gradient)

    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Evaluate div V = −⟨∇σ, n⟩ − σ (Δf − ⟨n, H n⟩)/‖∇f‖.

        Here σ = s e^{−γ f²} (g₁ − f) is the speed, n = ∇f/‖∇f‖, and H is the spatial Hessian of f.

        Args:
            p: Points (x, t) in space-time, shape (n, d + 1).
            f: Value and gradient of f at these points.

        Returns:
            Divergences, shape (n,).

        Raises:
            InputError: If f has no closed-form Hessian.
        """
        field, target = self._require_attached()
        gradient, difference = f.gradient[:, : self.dim], self._difference(p, f.value)
        length = _length(gradient)
        normal = gradient / length
        hessian = field.hessian(p, self.dim)[:, :, : self.dim]
        curvature = hessian.diagonal(dim1=1, dim2=2).sum(1) - torch.einsum("ni,nij,nj->n", normal, hessian, normal)
        target_slope = (_gradient(target, p[:, : self.dim]) * normal).sum(1)
        weight = self._weight(f.value)
        speed_slope = target_slope - length[:, 0] - 2 * self.decay * f.value * difference * length[:, 0]
        return -weight * speed_slope - weight * difference * curvature / length[:, 0]

    def _weight(self, value: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        return self.scale * torch.exp(-self.decay * value.square())

    def _difference(self, p: Float[Tensor, "n k"], value: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        return self._require_attached()[1](p[:, : self.dim]) - value

    def _require_attached(self) -> tuple[ScalarNetwork, SignedDistance]:
        if self._attached is None:
            raise ValueError("`Nise` must know f and the target, got neither. Try `velocity.attach(field, keys)`.")
        return self._attached


def _length(gradient: Float[Tensor, "n d"]) -> Float[Tensor, "n 1"]:
    """Compute ‖∇f‖, bounded away from zero so that it can be divided by."""
    return gradient.norm(dim=1, keepdim=True).clamp(min=torch.finfo(gradient.dtype).eps)


def _gradient(field: SignedDistance, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    with torch.enable_grad():
        x = x.detach().requires_grad_()
        return torch.autograd.grad(field(x).sum(), x)[0]
