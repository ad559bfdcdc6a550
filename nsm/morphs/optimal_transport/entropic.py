"""Entropic optimal transport between two point clouds, and the maps of space that it defines."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.extras import require

#: Entries of the matrix between points and anchors that are held at once: 4 MB in single precision fit into the cache.
_ENTRIES = 1 << 20


class _Projection(NamedTuple):
    """Barycentric projection of an entropic plan, x ↦ Σ_j π(y_j | x) y_j over its anchors y_j."""

    anchors: Float[Tensor, "m d"]
    #: g_j / ε + log b_j, where g is the dual potential and b_j = 1/m the mass of each anchor; constants cancel.
    log_weights: Float[Tensor, " m"]
    epsilon: float

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Weighted means of the anchors, shape (n, d), with π(y_j | x) ∝ b_j exp((g_j − ‖x − y_j‖²/2) / ε)."""
        bias = self.log_weights - self.anchors.square().sum(1) / (2 * self.epsilon)
        rows = max(1, _ENTRIES // len(self.anchors))
        # ‖x‖² is equal for all anchors and cancels
        return torch.cat(
            [
                torch.addmm(bias, chunk, self.anchors.T, alpha=1 / self.epsilon).softmax(1) @ self.anchors
                for chunk in x.split(rows)
            ]
        )


class EntropicMap(NamedTuple):
    """Debiased entropic map T(x) = x + Σ_j π(y_j | x) y_j − Σ_i π₀(x_i | x) x_i.

    π is the plan to the other cloud and π₀ the plan from the cloud to itself; their dual potentials extend both to all
    of space. The first sum alone contracts the image, as it averages over a width of ``blur``. The second sum contracts
    x in the same way, so that the difference cancels this bias. T = x − ∇φ, where φ is the dual potential of the
    Sinkhorn divergence.

    References:
        A.-A. Pooladian and J. Niles-Weed, Entropic estimation of optimal transport maps, 2021,
        https://arxiv.org/abs/2109.12004 (extension to all of space).
        J. Feydy et al., Interpolating between optimal transport and MMD using Sinkhorn divergences, AISTATS 2019,
        https://arxiv.org/abs/1810.08278 (Sinkhorn divergence).
        A.-A. Pooladian, M. Cuturi, and J. Niles-Weed, Debiaser beware: Pitfalls of centering regularized transport
        maps, ICML 2022, https://arxiv.org/abs/2202.08919 (debiased map).
    """

    towards: _Projection
    itself: _Projection

    def __call__(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Images of points, shape (n, d), which need not belong to the cloud."""
        return x + self.towards(x) - self.itself(x)


def entropic_maps(
    x: Float[Tensor, "n d"], y: Float[Tensor, "m d"], blur: float, scaling: float
) -> tuple[EntropicMap, EntropicMap]:
    """Solve optimal transport between two clouds of equal masses for the cost ‖x − y‖²/2 by Sinkhorn iterations.

    GeomLoss (https://www.kernel-operations.io/geomloss) without KeOps holds whole matrices of n², n m, and m² numbers:
    10000 points need about 3 GB. The clouds should therefore be few anchors of larger clouds, which the maps then move.

    Args:
        x: First cloud, shape (n, d).
        y: Second cloud, shape (m, d).
        blur: √ε in units of length, below which the plan does not resolve places.
        scaling: Ratio of successive values of √ε from the diameter of the clouds to ``blur``, between 0 and 1. Values
            nearer to 1 take more iterations and come nearer to the optimum.

    Returns:
        The map from x to y, and the map from y to x.
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
    """Dual potentials of the entropic plan, f/ε at x (n,) and g/ε at y (m,)."""
    require("geomloss", extra="ot", task="Optimal transport")
    from geomloss import SamplesLoss

    solve = SamplesLoss(
        "sinkhorn", p=2, blur=blur, scaling=scaling, debias=False, potentials=True, backend="tensorized"
    )
    f, g = solve(x, y)
    return f / blur**2, g / blur**2
