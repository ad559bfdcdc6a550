"""The losses of the authors' code: each from the formulas alone, by automatic differentiation in double precision."""

from __future__ import annotations

from typing import NamedTuple

import pytest
import torch
import torch.nn.functional as F
from hydra.utils import instantiate
from runs import composed
from torch import Tensor
from torch.func import hessian, jacrev, vmap

from nsm.fields import AdaDiv, Free, Gaussian, Nise, ScalarSiren, VectorSiren, Velocity
from nsm.losses import BatchEvaluation, Everywhere, LevelSet, OfficialNeumann
from nsm.sampling import Batch, Box, Fractions, MorphSampler, UniformTime
from nsm.shapes import Ball
from nsm.train.tasks import draw_pools
from nsm.types import Key

SURFACE, AMBIENT, INTERIOR = 8, 12, 20
KNOWN = SURFACE + AMBIENT


class Problem(NamedTuple):
    """Networks, end shapes, a batch, and all that the formulas speak of at its points, found by autograd."""

    evaluation: BatchEvaluation
    f: Tensor
    rate: Tensor
    gradient: Tensor
    distances: Tensor
    target_gradients: Tensor
    to_target: Tensor


class Slanted(Ball):
    """A ball whose field is no distance and whose gradient points elsewhere than away from its center."""

    def local_distance(self, p: Tensor) -> Tensor:
        return super().local_distance(p) * (1 + 0.5 * p[:, 2].sin())


def network(in_features: int, out_features: int) -> VectorSiren:
    return VectorSiren(in_features, out_features, 8, 2, omega=2.0)


def made(moving: Velocity) -> Problem:
    """A random batch, half of its known points at each end, and independent derivatives of f and of both targets."""
    field = ScalarSiren(4, 8, 2, omega=2.0).double()
    source, target = (Slanted(0.4, (x, 0.1, 0.0)).double() for x in (-0.2, 0.3))
    x = torch.rand(KNOWN + INTERIOR, 3, dtype=torch.float64) * 2 - 1
    t = torch.cat([torch.arange(KNOWN) % 2, torch.rand(INTERIOR)]).double()
    at_target = t[:KNOWN] == 1
    x[:SURFACE] = 0.4 * F.normalize(x[:SURFACE], dim=1)
    x[:SURFACE, 0] += torch.where(at_target[:SURFACE], 0.3, -0.2)
    x[:SURFACE, 1] += 0.1
    p = torch.cat([x, t[:, None]], 1)

    distances = torch.where(at_target, target(x[:KNOWN]), source(x[:KNOWN]))
    slopes = [vmap(jacrev(lambda y, shape=shape: shape(y[None])[0]))(x[:KNOWN]) for shape in (source, target)]
    gradients = torch.where(at_target[:, None], slopes[1], slopes[0])
    batch = Batch(p, distances.detach(), F.normalize(gradients[:SURFACE], dim=1))
    keys = Key(0.0, source), Key(1.0, target)
    moving.attach(field, keys)
    jacobian = vmap(jacrev(lambda q: field(q[None])[0]))(p)
    evaluation = BatchEvaluation(batch, field, moving.double(), keys=keys)
    return Problem(evaluation, field(p), jacobian[:, 3], jacobian[:, :3], distances, gradients, target(x))


def over_batch(values: Tensor) -> Tensor:
    """The mean over the batch of values that are zero where they are not given."""
    return values.sum() / (KNOWN + INTERIOR)


def misalignment(problem: Problem) -> Tensor:
    """1 − cos(∇f, ∇g) on and around the end shapes, over the batch."""
    f, g = problem.gradient[:KNOWN], problem.target_gradients
    return over_batch(1 - (f * g).sum(1) / (f.norm(dim=1) * g.norm(dim=1)))


def terms(overrides: str, problem: Problem) -> dict[str, Tensor]:
    """Each term of a composed loss; what attaches f to the ends is one."""
    values = instantiate(composed(overrides).loss)(problem.evaluation)[1]
    attached = values.pop("dirichlet") + values.pop("surface", torch.zeros(()).double())
    return {**values, "dirichlet": attached}


@pytest.mark.parametrize("velocity", [Free, AdaDiv])
def test_the_official_loss_is_what_the_authors_code_computes(velocity: type[Velocity]) -> None:
    problem = made(AdaDiv(3, network, Gaussian(0.3)) if velocity is AdaDiv else Free(3, network))
    f, p = problem.f, problem.evaluation.batch.points
    moving, jet = problem.evaluation._required_velocity(), problem.evaluation.f
    along = (problem.gradient * moving(p, jet)).sum(1)
    attached = (f[:KNOWN] - problem.distances).square() * torch.exp(-f[:KNOWN].square())
    near = torch.exp(-f.square()).mean()
    torch.testing.assert_close(
        terms("loss=official", problem),
        {
            "level_set": 1e5 * (problem.rate + along).square().mean(),
            "dirichlet": 1e4 * over_batch(attached),
            "neumann": 1e1 * misalignment(problem),
            "eikonal": 1e0 * (problem.gradient.norm(dim=1) - 1).square().mean() * near,
        },
    )


def test_the_official_nise_is_what_the_authors_code_computes() -> None:
    problem = made(instantiate(composed("method=nise_official").velocity, dim=3))
    f = problem.f
    speed = 0.5 * (problem.to_target - f) * torch.exp(-f.square())
    residual = problem.rate - speed * problem.gradient.norm(dim=1)
    torch.testing.assert_close(
        terms("method=nise_official", problem),
        {
            "level_set": 1e1 * residual.square().mean(),
            "dirichlet": 1e4 * over_batch((f[:KNOWN] - problem.distances).square()),
            "neumann": 1e1 * misalignment(problem),
        },
    )


def test_insd_without_landmarks_is_what_the_authors_code_computes() -> None:
    problem = made(Free(3, network))
    net, p = problem.evaluation._required_velocity().network, problem.evaluation.batch.points

    def value(q: Tensor) -> Tensor:
        return net(q[None])[0]

    jacobian = vmap(jacrev(value))(p)[:, :, :3]
    laplacian = vmap(hessian(value))(p)[:, :, :3, :3].diagonal(dim1=2, dim2=3).sum(2)
    normal = problem.gradient / problem.gradient.norm(dim=1, keepdim=True)
    stretching = -(normal * (jacobian @ normal[:, :, None])[:, :, 0]).sum(1)
    along = (problem.gradient * net(p)).sum(1)
    f = problem.f
    torch.testing.assert_close(
        terms("method=lf_insd", problem),
        {
            "level_set": 1e4 * (problem.rate + along + f * stretching).square().mean(),
            "smoothness": 1e1 * (net(p) - 0.01 * laplacian).square().mean(),
            "divergence": 1e1 * vmap(torch.trace)(jacobian).square().mean(),
            "dirichlet": 1e4 * over_batch((f[:KNOWN] - problem.distances).square()),
            "neumann": 1e1 * misalignment(problem),
        },
    )


def test_the_divergence_of_the_authors_insd_is_not_minimized_unless_it_is_asked_for() -> None:
    problem = made(Free(3, network))
    told = instantiate(composed("method=lf_insd").loss).terms["divergence"](problem.evaluation)
    asked = ["method=lf_insd", "loss.terms.divergence.term._target_=nsm.losses.Compression"]
    minimized = instantiate(composed(*asked).loss).terms["divergence"](problem.evaluation)
    torch.testing.assert_close(told, minimized.detach())
    assert not told.requires_grad
    assert minimized.requires_grad


def test_the_default_loss_evaluates_v_at_interior_points_only() -> None:
    evaluation = made(AdaDiv(3, network, Gaussian(0.3))).evaluation
    instantiate(composed().loss)(evaluation)
    assert len(evaluation.velocity) == INTERIOR
    assert not {"everywhere", "known_gradients"} & set(vars(evaluation))
    Everywhere(LevelSet(1.0))(evaluation)
    assert len(evaluation.everywhere.velocity) == KNOWN + INTERIOR
    assert evaluation.everywhere.f is evaluation.f


def test_a_batch_of_a_sampler_knows_the_gradients_of_its_end_shapes() -> None:
    ends = Ball(0.5, (0.2, 0.0, 0.0)), Ball(0.3)
    pools = {float(time): draw_pools(shape, 100, seed=0) for time, shape in enumerate(ends)}
    sampler = MorphSampler(pools, Box(3, 1.5), UniformTime(), 40, Fractions())
    batch = sampler.draw(torch.Generator().manual_seed(0))
    known = BatchEvaluation(batch, ScalarSiren(4, 8, 2), keys=[Key(0.0, ends[0]), Key(1.0, ends[1])]).known_gradients
    centers = torch.where(batch.points[:20, 3:] == 0, torch.tensor([0.2, 0.0, 0.0]), torch.zeros(3))
    torch.testing.assert_close(known, F.normalize(batch.points[:20, :3] - centers, dim=1), atol=1e-4, rtol=0)


def test_the_official_neumann_term_needs_the_end_shapes() -> None:
    evaluation = made(Nise(3)).evaluation
    with pytest.raises(ValueError, match="`keys` must be the shapes of the morph"):
        OfficialNeumann(1.0)(BatchEvaluation(evaluation.batch, evaluation.field))
