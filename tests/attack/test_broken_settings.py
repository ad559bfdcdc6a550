"""Broken settings end in one sentence before anything is computed, or they are good and build what they say."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from broken_settings import Case, cases, composed, defaults, everything
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from nightly import NIGHTLY
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from table import Tally

from nsm.cli.errors import InputError
from nsm.cli.explain import explain, require_settings
from nsm.cli.validation import validate
from nsm.train import __main__ as train

#: Combinations that would do something else than they say.
COMBINATIONS = [
    ["method=penalty", "loss=paper"],
    ["method=nise", "velocity=free"],
    ["method=lipmlp", "init=siren"],
    ["method=lipmlp", "+ablation=source_init"],
    ["method=ot", "velocity=free"],
    ["field=lipschitz"],
    ["field=lipschitz", "init=source"],
    ["velocity=none"],
    ["velocity=adadiv", "loss=lf_insd"],
    ["loss=insd", "velocity=free"],
    ["task=sdf", "steps=100"],
    ["task=sdf", "optimizer.lr=1e-3"],
    ["task=sdf", "optimizer=adam"],
    ["task=sdf", "loss=paper"],
    ["task=sdf", "shape@target=ball"],
    ["task=sdf", "method=free"],
    ["method=ot", "steps=100"],
    ["method=ot", "+ablation=no_eikonal"],
    ["method=ot", "+ablation=adam"],
    ["method=ot", "optimizer=adam"],
    ["method=free", "+ablation=beta_tight"],
    ["method=lf_insd", "+ablation=no_eikonal"],
    ["method=lf_insd", "+ablation=no_neumann"],
    ["loss=lipschitz", "+ablation=no_neumann"],
    ["+velocity.gamma=3"],
    ["+trainer.profilr=simple"],
    ["beta._target_=os.path.sep"],
    ["beta._target_=nsm.fields.NoBeta"],
    ["trainer.precision=bf16-mixed"],
    ["trainer.precision=16-mixed"],
    ["trainer.accelerator=tpu"],
    ["trainer.devices=[]"],
    ["trainer.strategy=telepathy"],
    ["threads=100000"],
    ["optimizer.betas=[2,3]"],
    ["optimizer.betas=[0.9]"],
    ["optimizer.betas=0.9"],
    ["optimizer.lr=-1e-3"],
    ["~optimizer.lr", "optimizer=adam"],
    ["~sampler.box"],
    ["~loss.terms"],
    ["sampler.box=3"],
    ["source.pose=3"],
    ["loss.terms={}"],
    ["loss.terms.volume=null"],
    ["callbacks.progress=null"],
    ["logger.csv=3"],
    ["network.field.hidden_layers=1000000000"],
    ["network.field.hidden_features=100000"],
    ["network.field.omega=[1,2,3]"],
    ["sampler.fractions.surface=0.9", "sampler.fractions.ambient=0.9"],
    ["sampler.time.start=1", "sampler.time.stop=0"],
    ["task.volume_resolution=0"],
    ["task.volume_times=1"],
]


class Built(Exception):
    """Raised where training would begin."""


def _begin(trainer: Any, *rest: Any, **more: Any) -> None:
    trainer()
    raise Built


@pytest.fixture(autouse=True)
def untrained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything is built as for a run, and nothing is trained."""
    monkeypatch.setattr(train, "fit_with_recovery", _begin)
    monkeypatch.setattr(train, "transport_run", lambda *given: _begin(lambda: None))
    monkeypatch.setattr(train, "use_threads", lambda config: None)
    monkeypatch.delenv("NSM_DATA_DIR", raising=False)


def verdict(command: str, overrides: list[str], setting: str | None = None) -> str:
    """The sentence with which a command refuses overrides and a setting, or "accepted"; anything else is raised."""
    before = HydraConfig.instance().cfg
    typed = [*overrides, *([setting] if setting else [])]
    try:
        require_settings(typed, command)
        cfg = copy.deepcopy(composed(command, (*overrides, "hydra.runtime.output_dir=/nowhere")))
        if setting:  # as Hydra applies it
            override = OverridesParser.create().parse_override(setting)
            OmegaConf.update(cfg, override.key_or_group, override.value(), merge=True)
        HydraConfig.instance().set_config(cfg)
        plain = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "hydra"])
        validate(plain, command)
        if command == "train":
            OmegaConf.to_container(plain, resolve=True, throw_on_missing=True)
            train.main(plain)
    except Built:
        return "accepted"
    except InputError as refusal:
        return str(refusal)
    except (HydraException, OmegaConfBaseException) as error:
        inner = error.__cause__
        return str(inner) if isinstance(inner, InputError) else explain(error, typed, command)
    finally:
        HydraConfig.instance().cfg = before
    return "accepted"


#: Small shapes and networks, to build quickly.
SMALL = ("network=small", "sampler.pool=100", "trainer.accelerator=cpu")


def _chosen() -> list[Case]:
    """Every ninth case at night, of which there are thousands, and by day some of the default choices."""
    return cases(everything)[::9] if NIGHTLY else cases(defaults)[4::97]


@pytest.mark.parametrize("case", _chosen(), ids=lambda case: f"{case.command}:{case.name}={case.value}")
def test_a_hostile_value_is_refused_or_good(case: Case, tally: Tally) -> None:
    name = case.name.partition(".")[0]
    disks = [f"shape@{end}=disk" for end in ("source", "target")] if name not in ("source", "target") else []
    small = [*disks, *SMALL] if case.command == "train" else []
    groups = {choice.partition("=")[0] for choice in case.choices}
    chosen = [*(o for o in small if o.partition("=")[0] not in {case.name, *groups}), *case.choices]
    with tally.attack("settings with hostile values"):
        said = verdict(case.command, chosen, f"{case.name}={case.value}")
        if case.good:
            assert said == "accepted" or " must " in said
        else:
            assert " must " in said, said
            assert ". Try " in said, said


@pytest.mark.parametrize("typed", COMBINATIONS if NIGHTLY else COMBINATIONS[::3], ids=" ".join)
def test_a_combination_that_does_something_else_is_refused(typed: list[str], tally: Tally) -> None:
    given = {override.partition("=")[0] for override in typed}
    disks = [f"shape@{end}=disk" for end in ("source", "target") if f"shape@{end}" not in given]
    disks = [o for o in disks if "task=sdf" not in typed or "target" not in o]
    with tally.attack("combinations of settings that contradict each other"):
        said = verdict("train", [*disks, *SMALL, *typed])
        assert " must " in said, said
        assert ". Try " in said, said
