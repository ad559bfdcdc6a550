"""Loss terms: zero for exact motions, the formulas they claim, and gradients to every weight."""

from __future__ import annotations

import pytest
import torch
from hydra.utils import instantiate
from problems import MOTIONS, ExactMotion
from runs import composed
from torch import Tensor

from nsm.cli.configuration import CONF
from nsm.fields import AdaDiv, Free, Gaussian, LipschitzMlp, Nise, NullDiv, ScalarSiren, VectorSiren, Velocity
from nsm.losses import (
    AmbientDirichlet,
    BatchEvaluation,
    DecoupledEikonal,
    Divergence,
    Eikonal,
    LevelSet,
    Neumann,
    NormalAlignment,
    NormalMatch,
    OfficialDirichlet,
    OfficialNeumann,
    OverBatch,
    SurfaceDirichlet,
    Term,
    WeightedSum,
)
from nsm.sampling import Batch
from nsm.shapes import Ball, LandmarkPairs
from nsm.types import Jet, Key

LOSSES = sorted(p.stem for p in (CONF / "loss").glob("*.yaml"))
BOUNDARY = [AmbientDirichlet, SurfaceDirichlet, OfficialDirichlet, NormalAlignment]


class Exact(BatchEvaluation):
    """An evaluation whose jets and velocities are given, in place of networks."""

    def __init__(self, batch: Batch, f: Jet, velocity: Tensor | None = None, divergence: Tensor | None = None) -> None:
        self.batch, self.dim = batch, batch.normals.shape[1]
        self.__dict__.update(f=f, velocity=velocity, divergence=divergence)


def known(motion: ExactMotion, n: int, t: float) -> tuple[Tensor, Tensor]:
    """Points and normals on an end of a motion, by Newton steps along the gradient."""
    x = torch.rand(n, motion.dim, dtype=torch.float64) * 1.2 - 0.6
    for _ in range(60):
        gradient = motion.gradient(x, t)
        x = x - (motion(x, t) / gradient.square().sum(1))[:, None] * gradient
    x = x[motion(x, t).abs() < 1e-12]
    assert len(x) > n / 2
    return x, torch.nn.functional.normalize(motion.gradient(x, t), dim=1)


def exactly(motion: ExactMotion, n: int = 60) -> Exact:
    """A batch with the targets of a motion's own ends, and everything known about it."""
    ends = [known(motion, n, t) for t in (0.0, 1.0)]
    around = torch.rand(2 * n, motion.dim, dtype=torch.float64) * 2 - 1
    inside = torch.rand(2 * n, motion.dim, dtype=torch.float64) * 2 - 1
    when = torch.cat(
        [torch.zeros(len(ends[0][0])), torch.ones(len(ends[1][0])), torch.arange(2 * n) // n, torch.rand(2 * n)]
    ).double()
    x = torch.cat([ends[0][0], ends[1][0], around, inside])
    normals = torch.cat([ends[0][1], ends[1][1]])
    value = motion(x, when)
    batch = Batch(torch.cat([x, when[:, None]], 1), value[: -2 * n].clone(), normals)
    batch.distances[batch.surface] = 0
    jet = Jet(value, torch.cat([motion.gradient(x, when), motion.rate(x, when)[:, None]], 1))
    t = when[batch.interior]
    return Exact(batch, jet, motion.velocity(inside, t), motion.divergence(inside, t))


def networks(velocity: type[Velocity] = Free, n: int = 40, dim: int = 3) -> BatchEvaluation:
    """Random networks and a random batch."""
    field = ScalarSiren(dim + 1, 8, 2, omega=3.0).double()

    def network(in_features: int, out_features: int) -> VectorSiren:
        return VectorSiren(in_features, out_features, 8, 2, omega=3.0)

    moving = velocity(dim, network, Gaussian()) if velocity is AdaDiv else velocity(dim, network)  # type: ignore[call-arg]
    normals = torch.nn.functional.normalize(torch.randn(n // 4, dim, dtype=torch.float64), dim=1)
    batch = Batch(
        torch.rand(n, dim + 1, dtype=torch.float64) * 2 - 1, torch.randn(n // 2, dtype=torch.float64), normals
    )
    keys = Key(0.0, Ball(0.4, (0.0,) * dim).double()), Key(1.0, Ball(0.3, (0.1,) * dim).double())
    return BatchEvaluation(batch, field, moving.double(), keys=keys)


@pytest.mark.parametrize("name", sorted(MOTIONS))
@pytest.mark.parametrize("dim", [2, 3])
def test_an_exact_motion_has_no_residual_in_any_term_that_it_satisfies(name: str, dim: int) -> None:
    motion = MOTIONS[name](dim)
    evaluation = exactly(motion)
    terms: list[type[Term]] = [LevelSet, *BOUNDARY]
    if motion.is_distance:
        terms += [Eikonal, DecoupledEikonal, Neumann, NormalMatch]
    if name != "growing_ball":
        terms.append(Divergence)
    for term in terms:
        residual = term(weight=1).residual(evaluation)
        assert residual.abs().max() < 1e-9, term
        assert term(weight=1, power=1)(evaluation) < 1e-9, term


def test_a_term_is_positive_where_its_equation_does_not_hold() -> None:
    evaluation = exactly(MOTIONS["squashed_ball"](3))
    assert Eikonal(1)(evaluation) > 1e-3
    assert NormalMatch(1)(evaluation) > 1e-3
    assert Divergence(1)(exactly(MOTIONS["growing_ball"](3))) > 1e-3
    resting = Exact(evaluation.batch, evaluation.f, torch.zeros_like(evaluation.velocity))
    assert LevelSet(1)(resting) > 1e-3


def test_the_level_set_equation_has_the_sign_of_equation_1() -> None:
    evaluation = exactly(MOTIONS["translating_ball"](2))
    back = Exact(evaluation.batch, evaluation.f, -evaluation.velocity)
    rate = evaluation.interior.gradient[:, 2]
    torch.testing.assert_close(LevelSet(1).residual(back), 2 * rate)


@pytest.mark.parametrize("power", [1, 2, 1.5])
def test_a_term_is_weight_times_the_mean_power_of_its_residual(power: float) -> None:
    evaluation, term = networks(), Eikonal(3.0, power)
    torch.testing.assert_close(term(evaluation), 3 * term.residual(evaluation).abs().pow(power).mean())


def test_each_term_is_averaged_where_it_is_defined() -> None:
    evaluation = networks(n=40)
    sizes = {term: len(term(weight=1).residual(evaluation)) for term in (LevelSet, Divergence, Eikonal, *BOUNDARY)}
    assert sizes == {
        LevelSet: 20,
        Divergence: 20,
        Eikonal: 40,
        AmbientDirichlet: 10,
        SurfaceDirichlet: 10,
        OfficialDirichlet: 20,
        NormalAlignment: 10,
    }


def test_over_batch_counts_zero_where_a_term_is_not_defined() -> None:
    evaluation, term = networks(n=40), Neumann(2.0, power=1)
    padded = torch.cat([term.residual(evaluation).abs(), torch.zeros(30, dtype=torch.float64)])
    torch.testing.assert_close(OverBatch(term)(evaluation), 2 * padded.mean())


def test_the_official_dirichlet_weights_squared_residuals_by_a_gaussian_of_f() -> None:
    evaluation = networks()
    f = evaluation.f.value[:20]
    expected = ((f - evaluation.batch.distances).square() * torch.exp(-f.square())).mean()
    torch.testing.assert_close(OfficialDirichlet(1)(evaluation), expected)


def test_the_decoupled_eikonal_is_the_mean_over_the_accidental_square() -> None:
    evaluation = networks()
    squared = (evaluation.f.gradient[:, :3].norm(dim=1, keepdim=True) - 1).square()
    naive = (squared * torch.exp(-evaluation.f.value.square())).mean()
    torch.testing.assert_close(DecoupledEikonal(1)(evaluation), naive)


def test_the_decoupled_eikonal_allocates_no_square_array() -> None:
    n = 300_000  # squared, in single precision, 335 GiB
    batch = Batch(torch.zeros(n, 3), torch.zeros(2), torch.ones(1, 2))
    assert DecoupledEikonal(1)(Exact(batch, Jet(torch.rand(n), torch.rand(n, 3)))).isfinite()


def test_the_papers_preset_takes_absolute_values() -> None:
    terms = instantiate(composed("loss=paper").loss).terms
    assert {term.power for term in terms.values()} == {1}
    evaluation = networks()
    expected = 1e5 * LevelSet(1).residual(evaluation).abs().mean()
    torch.testing.assert_close(terms["level_set"](evaluation), expected)


def suited_to(name: str) -> BatchEvaluation:
    """Networks that a preset can be used with."""
    if name == "lipschitz":
        return BatchEvaluation(networks().batch, LipschitzMlp(4, 8, 2).double())
    if name.startswith("nise"):
        evaluation, velocity = networks(), Nise(3)
        goal = Key(1.0, lambda x: x.norm(dim=1) - 0.5)
        velocity.attach(evaluation.field, [goal])
        return BatchEvaluation(evaluation.batch, evaluation.field, velocity, keys=evaluation._keys)
    if name.endswith("insd"):
        evaluation = networks(Free)
        pairs = LandmarkPairs(*(torch.rand(5, 3, dtype=torch.float64) for _ in range(2)))
        return BatchEvaluation(
            evaluation.batch, evaluation.field, evaluation._required_velocity(), pairs, keys=evaluation._keys
        )
    return networks(AdaDiv)


@pytest.mark.parametrize("name", LOSSES)
def test_every_preset_lets_a_gradient_reach_every_weight_of_both_networks(name: str) -> None:
    evaluation = suited_to(name)
    total, terms = instantiate(composed(f"loss={name}").loss)(evaluation)
    torch.testing.assert_close(total, sum(terms.values()))
    assert not any(value.requires_grad for value in terms.values())
    total.backward()
    moving = evaluation._velocity.named_parameters() if evaluation._velocity else ()
    for key, parameter in [*evaluation.field.named_parameters(), *moving]:
        assert parameter.grad is not None, key
        # the last bias of a potential is a constant, which differentiation takes away
        assert parameter.grad.abs().sum() > 0 or key == "network.linears.2.bias", key


@pytest.mark.parametrize("term", [Eikonal, LevelSet, *BOUNDARY, Neumann, NormalMatch, OfficialNeumann])
def test_every_term_lets_a_gradient_reach_f(term: type[Term]) -> None:
    evaluation = networks()
    term(weight=1)(evaluation).backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in list(evaluation.field.parameters())[:-1])


@pytest.mark.parametrize("velocity", [Free, AdaDiv])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_gradient_of_the_divergence_penalty_is_its_difference_quotient(velocity: type[Velocity], dim: int) -> None:
    evaluation = networks(velocity, dim=dim)
    moving, penalty = evaluation._required_velocity(), Divergence(1.0)

    def loss() -> Tensor:
        return penalty(BatchEvaluation(evaluation.batch, evaluation.field, moving))

    parameters = list(moving.parameters())
    gradients = torch.autograd.grad(loss(), parameters, materialize_grads=True)
    direction = [torch.randn_like(p) for p in parameters]
    slope = sum((g * d).sum() for g, d in zip(gradients, direction, strict=True))
    ends, h = [], 1e-5
    with torch.no_grad():
        for step in (h, -2 * h):
            for p, d in zip(parameters, direction, strict=True):
                p += step * d
            ends.append(loss())
    torch.testing.assert_close(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-9)
    assert all(g.abs().sum() > 0 for g in gradients[:-1])


def test_a_divergence_free_velocity_has_no_divergence_penalty() -> None:
    assert Divergence(1)(networks(NullDiv)) == 0


def test_a_term_that_contains_the_velocity_needs_one() -> None:
    evaluation = networks()
    still = BatchEvaluation(evaluation.batch, evaluation.field)
    with pytest.raises(ValueError, match=r"`velocity` must be set.*got none. Try `velocity=adadiv`"):
        WeightedSum({"level_set": LevelSet(1)})(still)


def test_networks_are_evaluated_once_for_all_terms() -> None:
    evaluation = networks()
    assert evaluation.f is evaluation.f
    assert evaluation.velocity is evaluation.velocity
