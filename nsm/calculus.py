"""Closed-form derivatives of sine networks, and the differential operators built from them.

A sine network with layers (W_l, b_l), the frequency ω folded into both, is

    h_0 = x,    z_l = W_l h_{l-1} + b_l,    h_l = sin z_l   (l = 1 … L),    y = W_{L+1} h_L + b_{L+1}.

Its derivatives follow from the chain rule without building a graph:

* a *scalar* network gives value and gradient by one reverse sweep,
  p_L = W_{L+1}ᵀ,  p_{l-1} = W_lᵀ (cos z_l ⊙ p_l),  ∇y = p_0;
* a *vector* network gives value and Jacobian by forward tangents,
  ∂_j z_l = W_l ∂_j h_{l-1},  ∂_j h_l = cos z_l ⊙ ∂_j z_l, the tangents of all points in one matrix product a layer;
* second derivatives follow by one more order of the same propagation.

The sweeps used in training are `torch.autograd.Function`s whose backward pass is written out as well, so a
training step allocates no graph inside the network and does only the matrix products that the chain rule asks
for. They can be differentiated once more, with respect to the weights and the input.

Layers are passed as a flat tuple ``(W_1, b_1, …, W_{L+1}, b_{L+1})``, W_l of shape (out, in), b_l of shape (out,).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from nsm.types import Jet, VectorJet

Layers = tuple[Tensor, ...]


def value(layers: Layers, x: Float[Tensor, "n k"]) -> Float[Tensor, "n m"]:
    """Evaluate the network at x (n, k); returns (n, m)."""
    h = x
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        h = torch.addmm(bias, h, weight.T).sin()
    return torch.addmm(layers[-1], h, layers[-2].T)


def value_and_gradient(layers: Layers, x: Float[Tensor, "n k"]) -> Jet:
    """Value (n,) and gradient (n, k) of a scalar network at x (n, k), by one reverse sweep."""
    return Jet(*_ScalarSweep.apply(x, *layers))


def value_and_jacobian(layers: Layers, x: Float[Tensor, "n k"], directions: int) -> VectorJet:
    """Value (n, m) and Jacobian (n, m, directions) of a vector network at x (n, k), by forward tangents.

    The Jacobian is taken with respect to the first ``directions`` coordinates of x (space, where time comes last).
    """
    return VectorJet(*_TangentSweep.apply(x, directions, *layers))


class _ScalarSweep(torch.autograd.Function):
    """Forward evaluation and reverse sweep of a scalar network, with the adjoint of both written out."""

    @staticmethod
    def forward(ctx, x: Tensor, *layers: Tensor) -> tuple[Tensor, Tensor]:
        weights, biases = layers[0::2], layers[1::2]
        h, sines, cosines = x, [], []
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            z = torch.addmm(bias, h, weight.T)
            cosines.append(z.cos())
            sines.append(h := z.sin_())
        y = h @ weights[-1][0] + biases[-1]

        p = weights[-1]  # the same row for every point: it broadcasts
        sensitivities, products = [], []
        for weight, cosine in zip(weights[-2::-1], cosines[::-1], strict=True):
            sensitivities.append(p)
            products.append(a := cosine * p)
            p = a @ weight
        ctx.save_for_backward(x, *weights, *sines, *cosines, *sensitivities[::-1], *products[::-1])
        ctx.depth = len(sines)
        return y, p

    @staticmethod
    @once_differentiable
    def backward(ctx, y_bar: Tensor, gradient_bar: Tensor) -> tuple[Tensor | None, ...]:
        n = ctx.depth
        x, saved = ctx.saved_tensors[0], ctx.saved_tensors[1:]
        weights, saved = saved[: n + 1], saved[n + 1 :]
        sines, cosines, sensitivities, products = (saved[i * n : (i + 1) * n] for i in range(4))
        weight_bars: list[Tensor] = []
        bias_bars: list[Tensor] = []

        # adjoint of the reverse sweep, from the input side up
        p_bar, curvatures = gradient_bar, []
        for weight, cosine, p, a in zip(weights[:-1], cosines, sensitivities, products, strict=True):
            weight_bars.append(a.T @ p_bar)
            a_bar = p_bar @ weight.T
            p_bar = a_bar * cosine
            curvatures.append(a_bar.mul_(p))

        # adjoint of the evaluation, from the output side down
        output_bar = torch.addmv(p_bar.sum(0), sines[-1].T, y_bar)
        h_bar = torch.outer(y_bar, weights[-1][0])
        for layer in range(n - 1, -1, -1):
            z_bar = h_bar.mul_(cosines[layer]).addcmul_(sines[layer], curvatures[layer], value=-1)
            weight_bars[layer].addmm_(z_bar.T, sines[layer - 1] if layer else x)
            bias_bars.append(z_bar.sum(0))
            if layer or ctx.needs_input_grad[0]:
                h_bar = z_bar @ weights[layer]
        x_bar = h_bar if ctx.needs_input_grad[0] else None

        grads: list[Tensor | None] = [x_bar]
        for weight_bar, bias_bar in zip(weight_bars, reversed(bias_bars), strict=True):
            grads += [weight_bar, bias_bar]
        return (*grads, output_bar[None], y_bar.sum()[None])


class _TangentSweep(torch.autograd.Function):
    """Forward evaluation with tangents of a vector network, with the adjoint of both written out.

    Every layer carries one array (1 + directions, n, width): the values first, then one slab a tangent.
    """

    @staticmethod
    def forward(ctx, x: Tensor, directions: int, *layers: Tensor) -> tuple[Tensor, Tensor]:
        weights, biases = layers[0::2], layers[1::2]
        n = x.shape[0]  # not len(), which would fix the number of points in an exported program
        z = torch.addmm(biases[0], x, weights[0].T)
        dz = weights[0].T[:directions, None]  # the same for every point: it broadcasts
        states, cosines, tangents = [], [], []
        for weight, bias in zip(weights[1:], biases[1:], strict=True):
            state = z.new_empty(1 + directions, n, z.shape[1])
            torch.sin(z, out=state[0])
            cosines.append(cosine := z.cos())
            torch.mul(cosine, dz, out=state[1:])
            states.append(state)
            tangents.append(dz)
            z_and_dz = (state.flatten(0, 1) @ weight.T).view(1 + directions, n, len(weight))
            z, dz = z_and_dz[0].add_(bias), z_and_dz[1:]
        ctx.save_for_backward(x, *weights, *states, *cosines, *tangents)
        ctx.depth, ctx.directions = len(states), directions
        return z, dz.permute(1, 2, 0)

    @staticmethod
    @once_differentiable
    def backward(ctx, value_bar: Tensor, jacobian_bar: Tensor) -> tuple[Tensor | None, ...]:
        depth, directions = ctx.depth, ctx.directions
        x, saved = ctx.saved_tensors[0], ctx.saved_tensors[1:]
        weights, saved = saved[: depth + 1], saved[depth + 1 :]
        states, cosines, tangents = (saved[i * depth : (i + 1) * depth] for i in range(3))

        adjoint = torch.cat([value_bar[None], jacobian_bar.permute(2, 0, 1)])
        grads: list[Tensor | None] = []
        for layer in range(depth - 1, -1, -1):
            rows = adjoint.flatten(0, 1)
            grads += [adjoint[0].sum(0), rows.T @ states[layer].flatten(0, 1)]
            adjoint = (rows @ weights[layer + 1]).view(1 + directions, len(x), weights[layer + 1].shape[1])
            curvature = (adjoint[1:] * tangents[layer]).sum(0)
            adjoint.mul_(cosines[layer])
            adjoint[0].addcmul_(states[layer][0], curvature, value=-1)
        input_weight_bar = adjoint[0].T @ x
        input_weight_bar[:, :directions] += adjoint[1:].sum(1).T
        grads += [adjoint[0].sum(0), input_weight_bar]
        x_bar = adjoint[0] @ weights[0] if ctx.needs_input_grad[0] else None
        return (x_bar, None, *reversed(grads))


def value_jacobian_and_laplacian(layers: Layers, x: Float[Tensor, "n k"], directions: int) -> tuple[VectorJet, Tensor]:
    """Value, Jacobian and Laplacian (n, m) of a vector network, by forward tangents of second order.

    The Laplacian is propagated as it is, without the single second derivatives:
    Δz_l = W_l Δh_{l-1},  Δh_l = cos z_l ⊙ Δz_l − sin z_l ⊙ Σ_j (∂_j z_l)²,  the sum over the first ``directions``
    coordinates. Written in differentiable operations: a loss on it can be back-propagated.
    """
    n = len(x)
    z = torch.addmm(layers[1], x, layers[0].T)
    tangents = layers[0].T[:directions, None].expand(-1, n, -1)
    laplacian = torch.zeros_like(z)
    for weight, bias in zip(layers[2::2], layers[3::2], strict=True):
        sine, cosine = z.sin(), z.cos()
        bent = cosine * laplacian - sine * tangents.square().sum(0)
        rows = torch.cat([sine[None], cosine * tangents, bent[None]])
        rows = (rows.flatten(0, 1) @ weight.T).view(directions + 2, n, len(weight))
        z, tangents, laplacian = rows[0] + bias, rows[1:-1], rows[-1]
    return VectorJet(z, tangents.permute(1, 2, 0)), laplacian


def value_gradient_and_hessian(layers: Layers, x: Float[Tensor, "n k"], directions: int) -> tuple[Jet, Tensor]:
    """Value, gradient (n, k) and Hessian (n, directions, k) of a scalar network, by the tangents of the reverse sweep.

    ∂_j p_{l-1} = W_lᵀ (cos z_l ⊙ ∂_j p_l − sin z_l ⊙ ∂_j z_l ⊙ p_l), the derivatives along the first ``directions``
    coordinates. Written in differentiable operations.
    """
    n = len(x)
    z = torch.addmm(layers[1], x, layers[0].T)
    tangents = layers[0].T[:directions, None].expand(-1, n, -1)
    arguments = [(z, tangents)]
    for weight, bias in zip(layers[2:-2:2], layers[3:-2:2], strict=True):
        tangents = (z.cos() * tangents) @ weight.T
        z = torch.addmm(bias, z.sin(), weight.T)
        arguments.append((z, tangents))
    value = z.sin() @ layers[-2][0] + layers[-1]
    p, p_tangents = layers[-2].expand(n, -1), z.new_zeros(directions, n, layers[-2].shape[1])
    for weight, (z, tangents) in zip(layers[-4::-2], reversed(arguments), strict=True):
        cosine = z.cos()
        p_tangents = (cosine * p_tangents - z.sin() * tangents * p) @ weight
        p = (cosine * p) @ weight
    return Jet(value, p), p_tangents.transpose(0, 1)


def tanh_value_and_gradient(layers: Layers, x: Float[Tensor, "n k"]) -> Jet:
    """Value (n,) and gradient (n, k) of a scalar network whose activations are tanh, by one reverse sweep.

    Written in differentiable operations.
    """
    h, slopes = x, []
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        h = torch.addmm(bias, h, weight.T).tanh()
        slopes.append(1 - h.square())
    p = layers[-2]
    for weight, slope in zip(layers[-4::-2], reversed(slopes), strict=True):
        p = (slope * p) @ weight
    return Jet(h @ layers[-2][0] + layers[-1], p)


def divergence(jacobian: Float[Tensor, "n d d"]) -> Float[Tensor, " n"]:
    """Divergence Σ_i ∂_i V_i (n,) of a field V with the Jacobian (n, d, d)."""
    return jacobian.diagonal(dim1=1, dim2=2).sum(1)


def potentials(dim: int) -> int:
    """How many scalar potentials make a divergence-free field: the entries of an antisymmetric matrix, d(d−1)/2."""
    return dim * (dim - 1) // 2


def antisymmetric_divergence(jacobian: Float[Tensor, "n p d"]) -> Float[Tensor, "n d"]:
    """The divergence-free field V_i = Σ_j ∂_j A_ij of an antisymmetric matrix field A, from its potentials' Jacobian.

    In 3D the potentials are D with A_ij = ε_ijk D_k, and V = curl D; in 2D there is one, H, and V = (∂_2 H, −∂_1 H),
    the skew gradient (paper, section 4 and appendix A; Richter-Powell et al., NeurIPS 2022, in any dimension).
    """
    dim = jacobian.shape[2]
    operator = _antisymmetric_operator(dim, jacobian.dtype, jacobian.device)
    return jacobian.flatten(1) @ operator


@lru_cache
def _antisymmetric_operator(dim: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """The matrix (p·d, d) that takes the flattened Jacobian of the potentials to V."""
    operator = torch.zeros(potentials(dim), dim, dim, dtype=dtype, device=device)
    pairs = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)] if dim == 3 else list(combinations(range(dim), 2))
    for k, (i, j) in enumerate(pairs):
        operator[k, j, i] = 1
        operator[k, i, j] = -1
    return operator.flatten(0, 1)
