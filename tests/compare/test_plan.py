"""Plans of studies: which runs they consist of, and which settings are not valid."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from studies import configuration

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.compare import run
from nsm.compare.plan import Budget, jobs, read_study


@pytest.mark.parametrize("file", sorted((CONF / "study").glob("*.yaml")), ids=lambda file: file.stem)
def test_every_study_names_runs_that_nsm_train_can_compose(file: Path) -> None:
    study = read_study(configuration(f"+study={file.stem}"))
    runs = jobs(study)
    assert len(runs) == len(study.pairs) * len(study.methods) * len(study.seeds)
    assert len({job.folder for job in runs}) == len(runs)
    special = {method.name for method in study.methods if method.overrides}
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for job in [runs[0], *(job for job in runs if job.method in special)]:
            assert compose("train", [*job.overrides, *run.OVERRIDES]).seed == job.seed


def test_table_9_is_eight_methods_on_two_pairs_for_eight_minutes() -> None:
    study = read_study(configuration("+study=table9"))
    eight = ["adadiv", "nulldiv", "free", "penalty", "nise", "lf_insd", "lipmlp", "ot"]
    assert [method.name for method in study.methods] == eight
    assert [pair.name for pair in study.pairs] == ["kitten_fandisk", "cylinders_torus"]
    assert study.budget == Budget(8.0, None)
    first = jobs(study)[0]
    assert first.overrides == ("+experiment=kitten_fandisk", "method=adadiv", "seed=0")
    assert first.folder == Path("outputs/studies/table9/runs/kitten_fandisk/adadiv")


def test_every_seed_has_a_folder_of_its_own_and_overrides_add_up() -> None:
    method = "{name: bare, method: free, overrides: ['+ablation=adam']}"
    pair = "{name: far, experiment: disk_translation, overrides: ['source.pose.translation=[-1,0]']}"
    given = (f"methods=[{method}]", f"pairs=[{pair}]", "seeds=[3,5]", "overrides=['validations=2']", "name=own")
    found = jobs(read_study(configuration(*given)))
    assert [job.folder for job in found] == [Path(f"outputs/studies/own/runs/far/bare/seed_{n}") for n in (3, 5)]
    assert found[1].overrides == (
        "+experiment=disk_translation",
        "method=free",
        "validations=2",
        "source.pose.translation=[-1,0]",
        "+ablation=adam",
        "seed=5",
    )


_PAIR = ["pairs=[cylinders_torus]"]


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["methods=[adadiw]"], r"`methods` must be a list of some of adadiv, .*, got adadiw. Try `methods=\[adadiv\]`"),
        (
            ["pairs=[kitten]"],
            "`pairs` must be a list of some of bust_max, .*, got kitten. Try `pairs=.kitten_fandisk.`",
        ),
        (["methods=[adadiv,adadiv]"], "with different names, got adadiv twice"),
        (["methods=[]"], "`methods` must be a list of some of adadiv, .* got .."),
        (["pairs=[]"], r"got \[\]. Try `\+study=ablation` or `\+study=figure2` or"),
        (["methods=[{name: a/b, method: free}]"], "letters, digits, and _ only .* got a/b"),
        (["methods=[{name: official, method: free}]"], "differ from official, got official"),
        (["methods=[{method: free, weight: 3}]"], "the keys name, method, and overrides only, got weight"),
        (["steps=10"], "must be null where `steps` is given, got minutes=8 and steps=10. Try `minutes=null steps=10`"),
        (["minutes=0"], "`minutes` must be positive and finite, got 0. Try `minutes=8`"),
        (["minutes=null", "steps=1.5"], "`steps` must be a positive integer, got 1.5"),
        (["seeds=[1,1]"], "a list of different integers, got .1, 1."),
        (["times=1"], "`times` must be an integer of at least 2, got 1"),
        (["ends=soft"], "`ends` must be one of exact, network, got soft"),
    ],
)
def test_what_cannot_be_compared_is_told_in_a_sentence(overrides: list[str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_study(configuration(*_PAIR[: "pairs" not in overrides[0]], *overrides))


def test_the_pairs_are_five_of_networks_and_three_of_meshes_with_three_seeds() -> None:
    study = read_study(configuration("+study=pairs"))
    assert [pair.name for pair in study.pairs[-3:]] == ["spot_rocker_arm", "suzanne_bunny", "teapot_fandisk"]
    assert (len(study.pairs), [method.name for method in study.methods], study.seeds) == (8, ["adadiv"], (0, 1, 2))
    assert study.budget == Budget(None, None)
    assert str(study.budget) == "the recipe's own number of steps"
    assert study.protocol.times == 11


@pytest.mark.parametrize("launcher", ["workers", "submitit", "slurm"])
def test_every_launcher_composes(launcher: str) -> None:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("compare", ["+study=figure2", f"hydra/launcher={launcher}"], return_hydra_config=True)
    assert "hydra_plugins" in cfg.hydra.launcher._target_
