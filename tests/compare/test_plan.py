"""Plans of studies: which runs they consist of, and which settings are not valid."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from studies import configuration

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.validation import validate
from nsm.compare import run
from nsm.compare.plan import Budget, Job, Study, jobs, read_study, trials

STUDIES = sorted((CONF / "study").rglob("*.yaml"))
#: Overrides of whole studies that were composed already; small studies share them.
COMPOSED: set[tuple[str, ...]] = set()


def name_of(file: Path) -> str:
    return file.relative_to(CONF / "study").with_suffix("").as_posix()


def checked(*overrides: str) -> Study:
    """The study of some overrides, read as the command reads it."""
    config = configuration(*overrides)
    validate(OmegaConf.create(config), "compare")
    return read_study(config)


@pytest.mark.parametrize("file", STUDIES, ids=name_of)
def test_every_study_names_runs_that_nsm_train_can_compose(file: Path) -> None:
    study = read_study(configuration(f"+study={name_of(file)}"))
    assert study.name == name_of(file).replace("/", "_"), "a study and its small version have folders of their own"
    runs = jobs(study)
    assert len(runs) == len(study.pairs) * len(study.methods) * len(study.seeds)
    assert len({job.folder for job in runs}) == len(runs)
    # tests of conf/ compose what has no overrides; a small study has those of the large one
    firsts = {job.method: job for job in reversed(runs) if job.pair == study.pairs[0].name}
    special = [firsts[method.name] for method in study.methods if method.overrides and file.parent.name != "small"]
    special += [job for job in runs[: len(runs) // len(study.seeds)] if _is_special(study, job)]
    if study.overrides and study.overrides not in COMPOSED:
        special.append(runs[0])
        COMPOSED.add(study.overrides)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for job in special:
            assert compose("train", [*job.overrides, *run.OVERRIDES]).seed == job.seed


def _is_special(study: Study, job: Job) -> bool:
    """Whether a run is the first one of a pair that changes the configuration."""
    return job.method == study.methods[0].name and any(p.name == job.pair and p.overrides for p in study.pairs)


def test_every_study_has_a_small_version_that_takes_minutes() -> None:
    large = {name_of(file) for file in STUDIES if file.parent.name == "study"}
    assert large == {file.stem for file in STUDIES if file.parent.name == "small"}
    for name in large:
        small = read_study(configuration(f"+study=small/{name}"))
        assert small.budget.minutes is None
        runs = len(jobs(small)) + len(trials(small, {(job.pair, job.method) for job in jobs(small)}))
        assert runs <= 50, name


def test_table_9_is_the_five_methods_of_the_paper_on_its_four_pairs_for_eight_minutes() -> None:
    study = read_study(configuration("+study=table9"))
    assert [method.name for method in study.methods] == ["adadiv", "nise", "lf_insd", "lipmlp", "ot"]
    assert [pair.name for pair in study.pairs] == ["feline_horse", "kitten_fandisk", "spot_bob", "cylinders_torus"]
    assert study.budget == Budget(8.0, None)
    assert study.printed["spot_bob"]["lipmlp"] == (0.48, 14)
    assert {len(methods) for methods in study.printed.values()} == {len(study.methods)}
    first = jobs(study)[0]
    assert first.overrides == ("+experiment=feline_horse", "method=adadiv", "seed=0")
    assert first.folder == Path("outputs/studies/table9/runs/feline_horse/adadiv/seed_0")


def test_each_trained_method_tries_every_learning_rate_and_runs_with_its_own() -> None:
    study = read_study(configuration("+study=figure13", "methods=[free,ot]", "seeds=[4,7]"))
    pair = "small_square_rectangle"
    tries = trials(study, {(pair, "free")})
    assert [job.rate for job in tries] == [5e-4, 1e-3, 2e-3]
    assert {job.seed for job in tries} == {4}
    assert tries[2].overrides[-2:] == ("optimizer.lr=0.002", "seed=4")
    runs = jobs(study, {(pair, "free"): 2e-3})
    assert tries[2] in runs, "the run of the first seed is the one that was tried"
    assert tries[2].name == f"{pair}/free/lr_0.002/seed_4"
    assert [job.rate for job in runs if job.pair == pair] == [2e-3, None, 2e-3, None]


def test_only_the_method_of_one_volume_grows() -> None:
    methods = {job.method: job for job in jobs(read_study(configuration("+study=figure13")))}
    assert (methods["adadiv"].growth, methods["free"].growth) == ("volume_linear", "none")


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
        (["pairs=[]"], r"got \[\]. Try `\+study=ablation` or `\+study=early_stopping` or"),
        (["methods=[{name: a/b, method: free}]"], "letters, digits, and _ only .* got a/b"),
        (["methods=[{name: official, method: free}]"], "differ from official, got official"),
        (
            ["methods=[{method: free, weight: 3}]"],
            "the keys name, method, overrides, and growth only",
        ),
        (["steps=10"], "must be null where `steps` is given, got minutes=8 and steps=10. Try `minutes=null steps=10`"),
        (["minutes=0"], r"`minutes` must be a number above 0 and at most 1e\+06, got 0. Try `minutes=8`"),
        (["minutes=null", "steps=1.5"], "`steps` must be a positive integer, got 1.5"),
        (["seeds=[1,1]"], "a list of different integers, got .1, 1."),
        *(
            (
                [f"learning_rates={given}"],
                "`learning_rates` must be a list of different learning rates, got .*"
                "Try `learning_rates=.5e-4,1e-3,2e-3.`",
            )
            for given in ("[]", "[1e-3,1e-3]", "1e-3")
        ),
        (["learning_rates=[0]"], "`learning_rates` must be positive and finite, got 0"),
        (["slices.axis=w"], "`slices.axis` must be one of x, y, z, got w"),
        (["methods=[{method: free, growth: none2}]"], "`methods.growth` must be one of none, .*, got none2"),
        (["+paper.spot_bob.ot=0.1"], "`paper.spot_bob.ot` must be a list of a variance and a maximum, got 0.1"),
        (["times=1"], "`times` must be an integer of at least 2, got 1"),
        (["ends=soft"], "`ends` must be one of exact, network, got soft"),
    ],
)
def test_what_cannot_be_compared_is_told_in_a_sentence(overrides: list[str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        checked(*_PAIR[: "pairs" not in overrides[0]], *overrides)


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
