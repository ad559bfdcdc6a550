"""Every file in conf/ composes, instantiates and trains."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
import torch
import trimesh
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from nightly import NIGHTLY
from runs import BARE, TINY, composed, files, train_here
from torch import nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.cli.configuration import CONF
from nsm.io.checkpoint import load_morph
from nsm.losses import WeightedSum
from nsm.sampling import Fractions
from nsm.train.consistency import effective

#: These morph published networks, which are data.
PUBLISHED = {"bust_max", "feline_horse", "kitten_fandisk", "spot_bob"}
#: The shapes of these take so long to prepare that they are trained at night.
SLOW = {"feline_horse", "kitten_fandisk_torus", "suzanne_bunny", "teapot_fandisk"}
#: So few points, so coarse, that optimal transport takes a second.
FEW = ("points=2000", "anchors=200", "blur=0.1", "kernel=0.08", "resolution=32")
#: Two meshes, whose vertices can be landmarks.
MESHES = ("shape@source=mesh", "source.path=a.obj", "shape@target=mesh", "target.path=b.obj")


def variants(group: str) -> list[str]:
    return sorted(p.stem for p in (CONF / group).glob("*.yaml"))


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.mark.parametrize("name", [name for name in variants("experiment") if NIGHTLY or name not in SLOW])
def test_every_experiment_trains_a_few_steps(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if name in PUBLISHED:
        request.getfixturevalue("data_dir")
    bare = [o for o in TINY if not o.startswith("callbacks.")]
    small = ["steps=3", "validations=1", "optimizer.lr=1e-5", "callbacks=none", f"hydra.run.dir={tmp_path}"]
    assert train_here(f"+experiment={name}", *bare, *small) == 0
    assert {"checkpoints/last.ckpt", "checkpoints/best.ckpt", "summary.json", "log/metrics.csv"} == files(tmp_path)


@pytest.mark.parametrize("name", variants("experiment"))
def test_every_experiment_names_its_shapes(name: str) -> None:
    cfg = composed(f"+experiment={name}")
    ends = [cfg.source, *(cfg.between or {}).values(), cfg.target]
    assert len(ends) >= 2
    assert all(shape._target_.startswith("nsm.shapes.") for shape in ends)


@pytest.mark.parametrize("name", variants("ablation"))
def test_every_ablation_changes_the_default_and_still_trains(name: str, tmp_path: Path) -> None:
    assert composed(f"+ablation={name}") != composed()
    bare, steps = BARE, ["steps=1", "optimizer.lr=1e-5"]
    if name.endswith("_init"):
        bare, steps = [o for o in BARE if not o.startswith("init=")], ["steps=100", "optimizer.lr=5e-3"]
    assert train_here(*bare, f"+ablation={name}", *steps, "validations=1", f"hydra.run.dir={tmp_path}") == 0


def test_ablations_stack() -> None:
    cfg = composed("+ablation=[no_eikonal,beta_wide,adam]")
    assert cfg.loss.terms.eikonal.weight == 0
    assert cfg.beta.alpha == 0.01
    assert cfg.velocity.beta.alpha == 0.01
    assert cfg.optimizer._target_ == "torch.optim.Adam"


def test_a_method_is_a_velocity_and_its_loss() -> None:
    chosen = {name: composed(f"method={name}") for name in variants("method")}
    assert {name: cfg.velocity._target_.rpartition(".")[2] for name, cfg in chosen.items() if cfg.velocity} == {
        "adadiv": "AdaDiv",
        "free": "Free",
        "insd": "Free",
        "lf_insd": "Free",
        "nise": "Nise",
        "nise_official": "Nise",
        "nulldiv": "NullDiv",
        "penalty": "Free",
    }
    assert composed("method=lipmlp").velocity == composed("method=ot").velocity == {}
    assert composed("method=lipmlp").field._target_ == "nsm.fields.LipschitzMlp"
    assert [name for name, cfg in chosen.items() if "divergence" in cfg.loss.terms] == ["insd", "lf_insd", "penalty"]


@pytest.mark.parametrize("name", variants("method"))
def test_every_method_trains_a_few_steps_in_the_plane_and_in_space(name: str, tmp_path: Path) -> None:
    landmarks = tmp_path / "landmarks.csv"
    for dim, experiment in ((2, ["+experiment=disk_translation"]), (3, [])):
        landmarks.write_text("\n".join(",".join(["0.1"] * (2 * dim)) for _ in range(3)))
        carries = name == "insd" or (dim == 2 and name not in {"lipmlp", "ot"})
        known = ["landmarks=table", f"landmarks.path={landmarks}"] if carries else []
        bare, small = [o for o in TINY if not o.startswith("callbacks.")], ["steps=3", "optimizer.lr=1e-5"]
        if name == "lipmlp":  # it starts from weights of its own, and must first learn to have a surface
            bare, small = [o for o in bare if not o.startswith("init=")], ["steps=1000", "optimizer.lr=3e-3"]
        if name == "ot":
            small = [f"task.transport.{setting}" for setting in FEW]
        run = [f"method={name}", *bare, *small, *known, "validations=1", "callbacks=none"]
        if name == "ot":  # it trains nothing, and refuses settings of training
            run = effective(run, "ot")
        assert train_here(*experiment, *run, f"hydra.run.dir={tmp_path}/{dim}") == 0
        morph = load_morph(tmp_path / str(dim))
        x = torch.rand(5, dim)
        velocity = morph.velocity(x, 0.5)
        assert (velocity is None) == (name in {"lipmlp", "ot"})
        assert velocity is None or velocity.shape == (5, dim)
        assert morph.gradient(x, 0.5).shape == (5, dim)
        assert ("landmarks" in morph.provenance) == carries


@pytest.mark.parametrize("name", variants("loss"))
def test_landmarks_add_a_term_to_a_loss_that_has_none(name: str) -> None:
    without = composed(f"loss={name}").loss.terms
    terms = composed(f"loss={name}", "landmarks=table", "landmarks.path=a.csv").loss.terms
    assert set(terms) == {*without, "landmarks"}
    assert terms.landmarks == (
        without.landmarks if name == "insd" else composed("landmarks=vertices", *MESHES).loss.terms.landmarks
    )
    given = ("landmarks=points", "landmarks.source=[[0,0]]", "landmarks.target=[[0,1]]")
    assert composed(f"loss={name}", *given).loss.terms == terms
    assert all(terms[other] == without[other] for other in without)


@pytest.mark.parametrize("name", [name for name in variants("velocity") if name != "none"])
def test_a_velocity_can_be_chosen_by_itself(name: str) -> None:
    chosen = composed(f"velocity={name}").velocity._target_
    assert chosen.rpartition(".")[2].lower() == name


@pytest.mark.parametrize("name", variants("optimizer"))
@pytest.mark.parametrize("schedule", variants("scheduler"))
def test_every_optimizer_descends_under_every_schedule(name: str, schedule: str) -> None:
    cfg = composed(f"optimizer={name}", f"scheduler={schedule}")
    weights = nn.Parameter(torch.ones(4, 3))
    optimizer = instantiate(cfg.optimizer, _convert_="all")([weights])
    scheduler = instantiate(cfg.scheduler)(optimizer, total_steps=10)
    assert isinstance(optimizer, Optimizer)
    assert isinstance(scheduler, LRScheduler)
    rates = []
    for _ in range(10):
        optimizer.zero_grad()
        weights.square().sum().backward()
        optimizer.step()
        rates.append(scheduler.get_last_lr()[0])
        scheduler.step()
    assert weights.square().sum() < 12
    assert 0 < max(rates) <= cfg.optimizer.lr


def test_the_schedule_rises_over_its_warmup_and_falls_to_its_floor() -> None:
    cfg = composed("scheduler=warmup_cosine", "scheduler.warmup=0.1", "scheduler.floor=0.2")
    optimizer = torch.optim.SGD([nn.Parameter(torch.ones(1))], lr=2.0)
    scheduler = instantiate(cfg.scheduler)(optimizer, total_steps=100)
    rates = []
    for _ in range(101):
        rates.append(scheduler.get_last_lr()[0])
        optimizer.step()
        scheduler.step()
    torch.testing.assert_close(rates[:10], [2 * (i + 1) / 10 for i in range(10)])
    assert rates[10] == pytest.approx(2)
    assert rates[55] == pytest.approx(0.2 * 2 + 0.8)
    assert rates[100] == pytest.approx(0.4)
    assert all(a >= b for a, b in pairwise(rates[10:]))


@pytest.mark.parametrize("name", variants("loss"))
def test_every_loss_is_a_sum_of_named_terms(name: str) -> None:
    loss = instantiate(composed(f"loss={name}").loss)
    assert isinstance(loss, WeightedSum)
    assert "dirichlet" in loss.terms


@pytest.mark.parametrize("name", ["nise", "insd"])
def test_baselines_have_the_weights_of_the_default(name: str) -> None:
    ours, theirs = (composed(f"loss={loss}").loss.terms for loss in ("ours", name))
    weights = {key: node.get("term", node).weight for key, node in theirs.items() if key in ours}
    assert weights == {key: ours[key].weight for key in weights}
    assert {"level_set", "dirichlet", "surface", "neumann"} <= set(weights)


@pytest.mark.parametrize("name", variants("field"))
def test_every_kind_of_f_has_the_size_that_networks_have(name: str) -> None:
    cfg = composed(f"field={name}")
    field = instantiate(cfg.field, in_features=4)
    assert (field.hidden_features, field.hidden_layers) == (
        cfg.network.field.hidden_features,
        cfg.network.field.hidden_layers,
    )


@pytest.mark.parametrize("name", variants("sampler"))
def test_every_sampler_can_be_made(name: str) -> None:
    sampler = instantiate(composed(f"sampler={name}").sampler, _convert_="all")
    assert isinstance(sampler["fractions"], Fractions)
    assert sampler["box"](dim=2).draw(3, torch.Generator()).shape == (3, 2)


@pytest.mark.parametrize("name", variants("budget"))
def test_every_budget_has_steps_and_points(name: str) -> None:
    cfg = composed(f"budget={name}")
    assert cfg.steps >= 1
    assert cfg.sampler.size >= 1


def test_an_experiment_may_be_cut_by_a_budget() -> None:
    assert composed("+experiment=kitten_fandisk", "budget=fast").steps < composed("+experiment=kitten_fandisk").steps


@pytest.mark.parametrize("name", variants("callbacks"))
def test_every_set_of_callbacks_can_be_made_and_keeps_checkpoints(name: str, tmp_path: Path) -> None:
    made = instantiate(composed(f"callbacks={name}", folder=str(tmp_path)).callbacks, _convert_="all")
    assert "checkpoints" in made


@pytest.mark.parametrize("name", variants("logger"))
def test_every_logger_writes_below_the_runs_folder(name: str, tmp_path: Path) -> None:
    offline = ["logger.wandb.offline=true"] if name == "wandb" else []
    made = instantiate(composed(f"logger={name}", *offline, folder=str(tmp_path)).logger, _convert_="all")
    assert {Path(logger.save_dir) for logger in made.values()} == {tmp_path}


@pytest.mark.parametrize("name", variants("align"))
def test_every_alignment_is_recorded_with_the_target(name: str, tmp_path: Path) -> None:
    files = []
    for end, middle in (("source", 900.0), ("target", 901.0)):
        mesh = trimesh.creation.icosphere(2)
        mesh.apply_translation([middle, 0, 0])
        mesh.export(tmp_path / f"{end}.obj")
        files += [f"shape@{end}=mesh", f"{end}.path={tmp_path}/{end}.obj"]
    bare = [o for o in TINY if not o.startswith(("callbacks.", "init="))]
    small = ["steps=1", "validations=1", "callbacks=none", f"hydra.run.dir={tmp_path}/run"]
    assert train_here(*files, *bare, *small, f"align={name}") == 0
    morph = load_morph(tmp_path / "run")
    assert morph.provenance["target"]["alignment"]["kind"] == name
    wanted = [1.0 if name == "shared" else 0.0, 0, 0]
    apart = (morph.target.exact_bounds() - morph.source.exact_bounds()).mean(0) / morph.source.similarity.scale
    torch.testing.assert_close(apart, torch.tensor(wanted).double(), atol=1e-3, rtol=0)


@pytest.mark.parametrize("name", variants("network"))
def test_every_network_has_the_size_that_the_fit_of_shapes_takes(name: str) -> None:
    cfg = composed(f"network={name}")
    for size in ("hidden_features", "hidden_layers", "omega"):
        assert cfg.sdf.network[size] == cfg.network.field[size]


def test_composing_leaves_no_trace() -> None:
    before = HydraConfig.instance().cfg
    composed("seed=7")
    assert HydraConfig.instance().cfg is before
