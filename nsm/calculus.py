"""Closed-form derivatives of networks, and the differential operators built from them.

A sine network with layers (W_l, b_l), the frequency ω folded into both, computes

    h_0 = x,    z_l = W_l h_{l-1} + b_l,    h_l = sin z_l   (l = 1 … L),    y = W_{L+1} h_L + b_{L+1}.

Its derivatives follow from the chain rule without a graph of operations:

* One reverse sweep gives value and gradient of a *scalar* network,
  p_L = W_{L+1}ᵀ,  p_{l-1} = W_lᵀ (cos z_l ⊙ p_l),  ∇y = p_0.
* Forward tangents give value and Jacobian of a *vector* network,
  ∂_j z_l = W_l ∂_j h_{l-1},  ∂_j h_l = cos z_l ⊙ ∂_j z_l, with one matrix product per layer for all tangents.
* Propagating one more order gives second derivatives.

The two sweeps that most training steps use are `torch.autograd.Function`s with a handwritten backward pass. A step
therefore records no graph inside the network and performs only the matrix products that the chain rule requires.
Their results can be differentiated once, with respect to weights and input.

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
    """Evaluate a sine network with ω folded into its layers at inputs of shape (n, k); returns shape (n, m)."""
    h = x
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        h = torch.addmm(bias, h, weight.T).sin()
    return torch.addmm(layers[-1], h, layers[-2].T)


def value_and_gradient(layers: Layers, x: Float[Tensor, "n k"]) -> Jet:
    """Evaluate a scalar sine network and its gradient at inputs of shape (n, k) by one reverse sweep.

    Example:
        >>> import torch
        >>> from nsm import calculus
        >>> layers = (torch.eye(2), torch.zeros(2), torch.ones(1, 2), torch.zeros(1))  # sin(x) + sin(y)
        >>> calculus.value_and_gradient(layers, torch.tensor([[0.0, torch.pi]])).gradient
        tensor([[ 1., -1.]])
    """
    return Jet(*_ScalarSweep.apply(x, *layers))


def value_and_jacobian(layers: Layers, x: Float[Tensor, "n k"], directions: int) -> VectorJet:
    """Evaluate a vector-valued sine network and its Jacobian by forward tangents.

    Args:
        layers: Weights and biases with ω folded in.
        x: Inputs, shape (n, k).
        directions: Number of leading inputs to differentiate by: d, for the spatial Jacobian at x = (position, time).

    Returns:
        Value, shape (n, m), and Jacobian, shape (n, m, directions).
    """
    return VectorJet(*_TangentSweep.apply(x, directions, *layers))


class _ScalarSweep(torch.autograd.Function):
    """Evaluation and reverse sweep of a scalar network, with a handwritten adjoint of both."""

    @staticmethod
    def forward(ctx, x: Tensor, *layers: Tensor) -> tuple[Tensor, Tensor]:
        weights, biases = layers[0::2], layers[1::2]
        h, sines, cosines = x, [], []
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            z = torch.addmm(bias, h, weight.T)
            cosines.append(z.cos())
            sines.append(h := z.sin_())
        y = h @ weights[-1][0] + biases[-1]

        p = weights[-1]  # one row for all points: broadcast
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

        # adjoint of the reverse sweep, from the first layer to the last
        p_bar, curvatures = gradient_bar, []
        for weight, cosine, p, a in zip(weights[:-1], cosines, sensitivities, products, strict=True):
            weight_bars.append(a.T @ p_bar)
            a_bar = p_bar @ weight.T
            p_bar = a_bar * cosine
            curvatures.append(a_bar.mul_(p))

        # adjoint of the evaluation, from the last layer to the first
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
    """Evaluation of a vector network with its tangents, with a handwritten adjoint of both.

    The state of a layer is one array of shape (1 + directions, n, width): the values, then one slice per tangent.
    """

    @staticmethod
    def forward(ctx, x: Tensor, directions: int, *layers: Tensor) -> tuple[Tensor, Tensor]:
        weights, biases = layers[0::2], layers[1::2]
        n = x.shape[0]  # len(x) would be a constant in an exported program
        z = torch.addmm(biases[0], x, weights[0].T)
        dz = weights[0].T[:directions, None]  # one slice for all points: broadcast
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


def value_jacobian_and_laplacian(
    layers: Layers, x: Float[Tensor, "n k"], directions: int
) -> tuple[VectorJet, Float[Tensor, "n m"]]:
    """Evaluate a vector-valued sine network, its Jacobian, and its Laplacian by second-order forward tangents.

    The Laplacian is propagated directly, without the individual second derivatives,

        Δz_l = W_l Δh_{l-1},  Δh_l = cos z_l ⊙ Δz_l − sin z_l ⊙ Σ_j (∂_j z_l)².

    Args as in `value_and_jacobian`. All operations are differentiable by autograd.

    Returns:
        Value, shape (n, m), with Jacobian, shape (n, m, directions), and Laplacian, shape (n, m).
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


def value_gradient_and_hessian(
    layers: Layers, x: Float[Tensor, "n k"], directions: int
) -> tuple[Jet, Float[Tensor, "n directions k"]]:
    """Evaluate a scalar sine network, its gradient, and its Hessian by tangents of the reverse sweep.

    The tangents of the sensitivities are

        ∂_j p_{l-1} = W_lᵀ (cos z_l ⊙ ∂_j p_l − sin z_l ⊙ ∂_j z_l ⊙ p_l).

    Args as in `value_and_jacobian`; one of the two derivatives runs over the first ``directions`` inputs. All
    operations are differentiable by autograd.

    Returns:
        Value, shape (n,), with gradient, shape (n, k), and Hessian, shape (n, directions, k).
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
    """Evaluate a scalar network with tanh activations and its gradient at inputs of shape (n, k) by one reverse sweep.

    All operations are differentiable by autograd.
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
    """Compute the divergence Σ_i ∂_i V_i, shape (n,), from the Jacobian of V, shape (n, d, d)."""
    return jacobian.diagonal(dim1=1, dim2=2).sum(1)


def potential_count(dim: int) -> int:
    """Count the potentials of a divergence-free field: the free entries of an antisymmetric matrix, d(d − 1)/2."""
    return dim * (dim - 1) // 2


def antisymmetric_divergence(jacobian: Float[Tensor, "n p d"]) -> Float[Tensor, "n d"]:
    """Compute the divergence-free field V_i = Σ_j ∂_j A_ij of an antisymmetric matrix field A.

    In 3D the potentials are D with A_ij = ε_ijk D_k, and V = curl D. In 2D there is a single potential H, and V is its
    skew gradient (∂_2 H, −∂_1 H) (paper, section 4 and appendix A).

    Args:
        jacobian: Spatial Jacobian of the p = d(d − 1)/2 potentials, shape (n, p, d).

    Returns:
        The field V, shape (n, d).

    References:
        Richter-Powell, Lipman, and Chen, Neural Conservation Laws: A Divergence-Free Perspective, NeurIPS 2022.
        https://arxiv.org/abs/2210.01741

    Example:
        >>> import torch
        >>> from nsm import calculus
        >>> calculus.antisymmetric_divergence(torch.tensor([[[3.0, 5.0]]]))  # ∇H = (3, 5)
        tensor([[ 5., -3.]])
    """
    dim = jacobian.shape[2]
    operator = _antisymmetric_operator(dim, jacobian.dtype, jacobian.device)
    return jacobian.flatten(1) @ operator


@lru_cache
def _antisymmetric_operator(dim: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Build the matrix, shape (p·d, d), that maps the flattened Jacobian of the potentials to V."""
    operator = torch.zeros(potential_count(dim), dim, dim, dtype=dtype, device=device)
    pairs = [(0, 1)] if dim == 2 else [(1, 2), (2, 0), (0, 1)] if dim == 3 else list(combinations(range(dim), 2))
    for k, (i, j) in enumerate(pairs):
        operator[k, j, i] = 1
        operator[k, i, j] = -1
    return operator.flatten(0, 1)
