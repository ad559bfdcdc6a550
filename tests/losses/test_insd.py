"""The terms of INSD, Lipschitz networks, and landmarks: exact solutions and formulas."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.func import hessian, jacrev, vmap

from nsm.cli.errors import InputError
from nsm.fields import AdaDiv, Free, Gaussian, LipschitzMlp, ScalarSiren, VectorSiren
from nsm.losses import (
    BatchEvaluation,
    Compression,
    EndEikonal,
    LandmarkMatch,
    LevelSet,
    LipschitzBound,
    ModifiedLevelSet,
    Ramp,
    Smoothness,
)
from nsm.sampling import Batch
from nsm.shapes import LandmarkPairs
from nsm.types import Jet, VectorJet


class Given(BatchEvaluation):
    """An evaluation whose jets are given, in place of networks."""

    def __init__(self, batch: Batch, f: Jet, motion: tuple[VectorJet, Tensor]) -> None:
        self.batch, self.dim = batch, batch.normals.shape[1]
        self.__dict__.update(f=f, velocity_jet_and_laplacian=motion, velocity=motion[0].value)


def network(in_features: int, out_features: int) -> VectorSiren:
    return VectorSiren(in_features, out_features, 8, 2, omega=2.0)


def evaluation(dim: int = 3, n: int = 12) -> BatchEvaluation:
    points = torch.rand(n, dim + 1, dtype=torch.float64) * 2 - 1
    nothing = torch.zeros(0, dtype=torch.float64)
    batch = Batch(points, nothing, nothing.view(0, dim))
    return BatchEvaluation(batch, ScalarSiren(dim + 1, 8, 2, omega=2.0).double(), Free(dim, network).double())


def stretching_ball(n: int = 40, rate: float = 0.7) -> Given:
    """f = ‖x‖ − e^{at} under V = a x: the level-set equation fails off the surface by a f, which is −f R."""
    x, t = torch.rand(n, 3, dtype=torch.float64) * 2 - 1, torch.rand(n, dtype=torch.float64)
    length = x.norm(dim=1)
    f = Jet(
        length - torch.exp(rate * t),
        torch.cat([x / length[:, None], -rate * torch.exp(rate * t)[:, None]], 1),
    )
    jacobian = rate * torch.eye(3, dtype=torch.float64).expand(n, 3, 3)
    nothing = torch.zeros(0, dtype=torch.float64)
    batch = Batch(torch.cat([x, t[:, None]], 1), nothing, nothing.view(0, 3))
    return Given(batch, f, (VectorJet(rate * x, jacobian), torch.zeros_like(x)))


def test_the_modified_equation_holds_for_a_distance_that_is_stretched() -> None:
    ball = stretching_ball()
    assert ModifiedLevelSet(1.0).residual(ball).abs().max() < 1e-12
    assert ModifiedLevelSet(1.0, relaxation=0.5).residual(ball).abs().max() > 0.1
    assert Compression(1.0)(ball) == pytest.approx((3 * 0.7) ** 2)


def test_without_relaxation_it_is_the_level_set_equation() -> None:
    ball = stretching_ball()
    torch.testing.assert_close(ModifiedLevelSet(1.0, relaxation=0.0).residual(ball), LevelSet(1.0).residual(ball))


def test_smoothness_is_the_norm_of_the_velocity_less_its_laplacian() -> None:
    given = evaluation()
    p, net = given.batch.points, given._required_velocity().network

    def value(q: Tensor) -> Tensor:
        return net(q[None])[0]

    laplacian = vmap(hessian(value))(p)[:, :, :3, :3].diagonal(dim1=2, dim2=3).sum(2)
    torch.testing.assert_close(
        Smoothness(1, alpha=0.3, gamma=2).residual(given), (2 * net(p) - 0.3 * laplacian).norm(dim=1)
    )
    jacobian = vmap(jacrev(value))(p)[:, :, :3]
    torch.testing.assert_close(Compression(1).residual(given), vmap(torch.trace)(jacobian))


def test_smoothness_rejects_a_velocity_without_second_derivatives() -> None:
    given = evaluation()
    moving = AdaDiv(3, network, Gaussian()).double()
    with pytest.raises(InputError, match=r"must provide second derivatives.*got AdaDiv. Try `velocity=free`"):
        Smoothness(1)(BatchEvaluation(given.batch, given.field, moving))


def turning(evaluation: BatchEvaluation) -> BatchEvaluation:
    """V turns by a quarter about the last axis, from t = 0 to 1."""

    def moved(p: Tensor) -> Tensor:
        return math.pi / 2 * torch.stack([-p[:, 1], p[:, 0], 0 * p[:, 2]], 1)

    evaluation.velocity_at = moved  # type: ignore[method-assign]
    return evaluation


def test_landmarks_that_arrive_have_no_residual_and_the_order_is_four() -> None:
    given, source = turning(evaluation()), torch.rand(6, 3, dtype=torch.float64)
    given.landmarks = LandmarkPairs(source, torch.stack([-source[:, 1], source[:, 0], source[:, 2]], 1))
    coarse, fine = (LandmarkMatch(1, steps=steps).residual(given).max().item() for steps in (4, 8))
    assert fine < 1e-4
    assert math.log2(coarse / fine) == pytest.approx(4, abs=0.2)


def test_successive_steps_use_all_landmarks_in_subsets_that_depend_on_progress_alone() -> None:
    given = turning(evaluation())
    pairs = LandmarkPairs(torch.arange(30, dtype=torch.float64).view(10, 3), torch.zeros(10, 3, dtype=torch.float64))
    term = LandmarkMatch(1, count=4)
    chosen = [term._subset(pairs, step / 100).source[:, 0] / 3 for step in range(100)]
    assert all(len(set(some.tolist())) == 4 for some in chosen)
    assert set(torch.cat(chosen).tolist()) == set(range(10))
    torch.testing.assert_close(chosen[7], term._subset(pairs, 0.07).source[:, 0] / 3)
    given.landmarks = pairs
    assert term.residual(given).shape == (4,)


def test_landmarks_teach_the_velocity_but_not_f_through_it() -> None:
    given = evaluation()
    given.landmarks = LandmarkPairs(*(torch.rand(3, 3, dtype=torch.float64) for _ in range(2)))
    LandmarkMatch(1)(given).backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in given._required_velocity().parameters())
    assert all(p.grad is None or (p.grad == 0).all() for p in given.field.parameters())


def test_a_loss_names_the_setting_that_it_lacks() -> None:
    with pytest.raises(InputError, match=r"`landmarks` must be set for this loss, got none. Try `landmarks=table"):
        LandmarkMatch(1)(evaluation())
    with pytest.raises(InputError, match=r"must be a Lipschitz network.* got ScalarSiren. Try `field=lipschitz`"):
        LipschitzBound(1)(evaluation())


def test_the_lipschitz_term_is_the_bound() -> None:
    field = LipschitzMlp(4, 8, 2).double()
    term = LipschitzBound(1e-2, power=1)(BatchEvaluation(evaluation().batch, field))
    torch.testing.assert_close(term, 1e-2 * field.bound)


def test_the_eikonal_equation_at_the_ends_ignores_interior_points() -> None:
    n, gradient = 8, torch.zeros(8, 4, dtype=torch.float64)
    gradient[:, 0] = torch.tensor([1, 1, 1, 1, 1, 1, 5, 5])
    batch = Batch(torch.zeros(n, 4).double(), torch.zeros(6).double(), torch.zeros(3, 3).double())
    motion = (VectorJet(gradient, gradient[..., None]), gradient)
    assert EndEikonal(1)(Given(batch, Jet(torch.zeros(n).double(), gradient), motion)) == 0
    gradient[4, 0] = 3
    assert EndEikonal(6)(Given(batch, Jet(torch.zeros(n).double(), gradient), motion)) == 4


@pytest.mark.parametrize(("progress", "share"), [(0.0, 0), (0.2, 0), (0.35, 0.5), (0.5, 1), (1.0, 1)])
def test_a_ramp_scales_a_term_by_the_progress_of_training(progress: float, share: float) -> None:
    ball = stretching_ball()
    ball.progress = progress
    term = ModifiedLevelSet(1.0, relaxation=0.0)
    torch.testing.assert_close(Ramp(term, 0.2, 0.5)(ball), share * term(ball))


@pytest.mark.parametrize(("start", "stop"), [(0.5, 0.5), (0.6, 0.5), (-0.1, 0.5), (0.5, 1.1)])
def test_a_ramp_rejects_fractions_out_of_order(start: float, stop: float) -> None:
    with pytest.raises(InputError, match=f"must be fractions of training.*got {start} and {stop}. Try"):
        Ramp(ModifiedLevelSet(1.0), start, stop)
