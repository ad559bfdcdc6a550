"""Optimal transport between two clouds of points, and the map that it makes of all of space."""

from __future__ import annotations

from typing import NamedTuple

import torch
from geomloss import SamplesLoss
from jaxtyping import Float
from torch import Tensor

#: Entries of the matrix between points and anchors that are held at once: 4 MB in single precision stay in cache.
_ENTRIES = 1 << 20


class _Projection(NamedTuple):
    """The mean anchor, weighted as an entropic plan weights them: x ↦ Σ_j π(y_j | x) y_j."""

    anchors: Float[Tensor, "m d"]
    #: g_j / ε + log b_j, with g the dual potential and b_j = 1/m the mass of each anchor; constants cancel.
    log_weights: Float[Tensor, " m"]
    epsilon: float

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """The mean anchors (n, d), for π(y_j | x) ∝ b_j exp((g_j − ‖x − y_j‖²/2) / ε)."""
        bias = self.log_weights - self.anchors.square().sum(1) / (2 * self.epsilon)
        rows = max(1, _ENTRIES // len(self.anchors))
        # ‖x‖² is the same for all anchors and cancels
        return torch.cat(
            [
                torch.addmm(bias, chunk, self.anchors.T, alpha=1 / self.epsilon).softmax(1) @ self.anchors
                for chunk in x.split(rows)
            ]
        )


class EntropicMap(NamedTuple):
    """The debiased entropic map T(x) = x + Σ_j π(y_j | x) y_j − Σ_i π₀(x_i | x) x_i.

    π is the plan to the other cloud and π₀ that of the cloud to itself, both continued from the cloud to all of space
    by their dual potentials. The first sum alone draws every image inwards, for it is a mean over a width of ``blur``;
    the last one does the same to x itself, and the difference takes that back. T = x − ∇φ, φ the dual potential of the
    Sinkhorn divergence.

    References:
        Pooladian and Niles-Weed, Entropic estimation of optimal transport maps, 2021, for the map off the cloud;
        Feydy et al., Interpolating between optimal transport and MMD using Sinkhorn divergences, AISTATS 2019, and
        Pooladian, Cuturi and Niles-Weed, Debiaser beware, ICML 2022, for the last sum.
    """

    towards: _Projection
    itself: _Projection

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """The images (n, d) of points (n, d), which need not be in the cloud, a chunk at a time."""
        return x + self.towards(x) - self.itself(x)


def entropic_maps(
    x: Float[Tensor, "n d"], y: Float[Tensor, "m d"], blur: float, scaling: float
) -> tuple[EntropicMap, EntropicMap]:
    """Solve the transport between two clouds of equal masses, for the cost ‖x − y‖²/2, by Sinkhorn iterations.

    GeomLoss keeps whole matrices, of n² , n m and m² numbers: ten thousand points need about 3 GB. So the clouds are
    to be few anchors of larger ones, which the maps then carry.

    Args:
        x, y: the clouds.
        blur: √ε, in units of length: below it the plan does not resolve places.
        scaling: ratio of successive values of √ε, from the diameter of the clouds to ``blur``; between 0 and 1, and
            the nearer to 1, the more iterations, and the nearer to the optimum.

    Returns:
        the maps from x to y, and from y to x.
    """
    with torch.no_grad():
        to_x, to_y = _potentials(x, y, blur, scaling)
        within_x, within_y = (_potentials(z, z, blur, scaling)[0] for z in (x, y))
    towards_y, towards_x = _Projection(y, to_y, blur**2), _Projection(x, to_x, blur**2)
    return (
        EntropicMap(towards_y, _Projection(x, within_x, blur**2)),
        EntropicMap(towards_x, _Projection(y, within_y, blur**2)),
    )


def _potentials(x: Tensor, y: Tensor, blur: float, scaling: float) -> tuple[Tensor, Tensor]:
    """f/ε at x (n,) and g/ε at y (m,): the dual potentials of the entropic plan."""
    solve = SamplesLoss(
        "sinkhorn", p=2, blur=blur, scaling=scaling, debias=False, potentials=True, backend="tensorized"
    )
    f, g = solve(x, y)
    return f / blur**2, g / blur**2
