"""Studies: what they run, what they survive, what they show."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import cloudpickle
import lightning as L
import pytest
import torch
from analytic import sentence
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from runs import BARE, train_here

from nsm.cli import entry
from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.compare import __main__ as compare
from nsm.compare import results, run
from nsm.compare.goals import goals_table
from nsm.compare.plan import Budget, Job, jobs, read_study
from nsm.compare.record import FAILED, INTERRUPTED, prepare, read_record
from nsm.metrics.unit import COUNT
from nsm.plots.tables import Cell, Column, Table, comma_separated, latex, markdown, write_table
from nsm.train.callbacks import StepTimes

#: A study so small that a run takes a second.
SMALL = (
    "+study=figure2",
    "methods=[adadiv,free]",
    "minutes=null",
    "steps=3",
    "threads=1",
    "volume_resolution=16",
    "surface_resolution=16",
    "times=3",
    "strip_times=[0,1]",
    "picture_size=24",
)
#: What makes each of its runs tiny.
TINY = [o for o in BARE if not o.startswith(("+experiment", "steps", "threads", "callbacks"))]


def configuration(*overrides: str) -> dict[str, Any]:
    """The configuration of ``python -m nsm.compare``, without what only the command itself knows."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("compare", [*overrides])
    return OmegaConf.to_container(cfg, resolve=True)  # type: ignore[return-value]


def compare_here(*overrides: str) -> int:
    before = sys.argv
    sys.argv = ["nsm.compare", *overrides]
    try:
        entry.run(compare.main, "compare")
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


def tiny(folder: Path, *overrides: str) -> tuple[str, ...]:
    return (*SMALL, f"output={folder}", f"overrides={json.dumps(TINY)}", *overrides)


def forked(arguments: Sequence[str], log: Path, threads: int | None) -> int:
    """Train in a copy of this process, which needs no time to import anything."""
    log.parent.mkdir(parents=True, exist_ok=True)
    child = os.fork()
    if child == 0:
        GlobalHydra.instance().clear()
        with log.open("w") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
            try:
                status = train_here(*arguments)
            except BaseException as error:
                print(f"{type(error).__name__}: {error}")  # noqa: T201
                status = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders of the runs that were started, by forking."""
    folders: list[Path] = []

    def note(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        folders.append(log.parent)
        return forked(arguments, log, threads)

    monkeypatch.setattr(run, "_start", note)
    return folders


def rows(folder: Path) -> dict[str, dict[str, Any]]:
    return {row["method"]: row for row in json.loads((folder / "study.json").read_text())["rows"]}


# what a study consists of


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


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["methods=[adadiw]"], r"methods has adadiw, which is no method of nsm: give some of adadiv, .*mean adadiv\?"),
        (["pairs=[kitten]"], "pairs has kitten, which is no experiment of nsm: give some of bust_max, cylinders_torus"),
        (["methods=[adadiv,adadiv]"], "methods has adadiv twice"),
        (["methods=[]"], "leaves nothing to compare"),
        (["pairs=[]"], r"pairs=\[\] leaves nothing to compare: give \+study=ablation or \+study=figure2 or"),
        (["methods=[{name: a/b, method: free}]"], "no folder of a run can have"),
        (["methods=[{name: official, method: free}]"], "no folder of a run can have"),
        (["methods=[{method: free, weight: 3}]"], "an entry with weight"),
        (["steps=10"], "must not both be given, got minutes=8 and steps=10. Try minutes=null steps=10, or both null"),
        (["minutes=0"], "minutes=0 is no time"),
        (["minutes=null", "steps=1.5"], "`steps` must be a positive integer, got 1.5"),
        (["seeds=[1,1]"], "not to be drawn from"),
        (["times=1"], "`times` must be an integer of at least 2, got 1"),
        (["ends=soft"], "`ends` must be one of exact, network, got soft"),
    ],
)
def test_what_cannot_be_compared_is_told_in_a_sentence(overrides: list[str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_study(configuration(*_PAIR[: "pairs" not in overrides[0]], *overrides))


_PAIR = ["pairs=[cylinders_torus]"]

# running it


def test_a_study_ends_with_a_folder_that_shows_it_and_a_failed_run_is_a_row(
    tmp_path: Path, started: list[Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = tiny(tmp_path, "methods=[adadiv,insd]", "official=true")
    assert compare_here(*command) == 0
    assert [folder.name for folder in started] == ["adadiv", "insd"]
    found = rows(tmp_path)
    assert "landmarks" in found["insd"]["reason"]
    assert found["official"]["reason"] == "the authors published no morph of this pair"
    assert found["adadiv"]["reason"] is None
    assert found["adadiv"]["steps"] == 3
    assert found["adadiv"]["step_s"] > 0
    assert found["adadiv"]["terms"]["level_set"] >= 0
    assert "volume std" in found["adadiv"]["figures"]
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if "runs" not in path.parts}
    pictures = {"strip_disk_translation.png", "volume_disk_translation.png", "times.png"}
    tables = {f"{stem}{suffix}" for stem in _STEMS for suffix in (".md", ".csv", ".tex")}
    assert names >= {"README.md", "study.json", *pictures, *tables}
    page = (tmp_path / "README.md").read_text()
    assert "| disk_translation | insd | 0 |" in page
    for link in (*pictures, "tables/volume_std.md"):
        assert f"({link})" in page
    with (tmp_path / "tables" / "volume_std.csv").open(newline="") as file:
        table = list(csv.reader(file))
    assert table[0] == ["method", "disk_translation"]
    assert [row[0] for row in table[1:]] == ["adadiv", "insd", "official"]
    assert float(table[1][1]) == pytest.approx(found["adadiv"]["figures"]["volume std"])

    # once more: nothing runs, nothing is measured
    monkeypatch.setattr(results, "evaluate_morph", lambda *rest: pytest.fail("measured again"))
    del started[:]
    assert compare_here(*command) == 0
    assert not started
    assert rows(tmp_path) == found
    capsys.readouterr()

    # with another budget it is another study
    assert compare_here(*command, "steps=4") == 2
    assert "was begun with steps=3 (now 4): repeat the command it was begun with" in sentence(capsys.readouterr().err)

    # another protocol measures again, and trains nothing
    monkeypatch.undo()
    monkeypatch.setattr(run, "_start", lambda *rest: pytest.fail("trained again"))
    assert compare_here(*command, "times=5") == 0
    assert len(rows(tmp_path)["adadiv"]["volume"]["times"]) == 5

    # and so do other ends
    assert "flow map" not in rows(tmp_path)["adadiv"]["figures"]
    assert compare_here(*command, "ends=exact") == 0
    figures = rows(tmp_path)["adadiv"]["figures"]
    assert figures["morph to shape t=1"] < 1e-5 < found["adadiv"]["figures"]["morph to shape t=1"]
    assert figures["flow map"] < 1e-3


def test_the_pairs_are_five_of_networks_and_three_of_meshes_with_three_seeds() -> None:
    study = read_study(configuration("+study=pairs"))
    assert [pair.name for pair in study.pairs[-3:]] == ["spot_rocker_arm", "suzanne_bunny", "teapot_fandisk"]
    assert (len(study.pairs), [method.name for method in study.methods], study.seeds) == (8, ["adadiv"], (0, 1, 2))
    assert study.budget == Budget(None, None)
    assert str(study.budget) == "the recipe's own number of steps"
    assert study.protocol.times == 11


def test_without_a_budget_a_run_makes_the_steps_of_its_recipe(tmp_path: Path, started: list[Path]) -> None:
    job = Job("disk", "adadiv", 0, ("+experiment=disk_translation", "method=adadiv", *TINY, "steps=4"), tmp_path / "r")
    record = prepare(job, Budget(None, None), trained=True, threads=1, retry=False)
    assert record.steps is None
    assert run.carry_out({"folder": str(job.folder)}) == "done"
    assert started == [job.folder], "nothing is measured first"
    assert read_record(job.folder).steps == 4  # type: ignore[union-attr]
    assert prepare(job, Budget(None, None), True, 1, retry=False).state == "done"


def outcome(pair: str, seed: int | None, scale: float, method: str = "adadiv", **more: Any) -> results.Result:
    """A result whose every figure is a multiple of its place in the list."""
    figures = {name: scale * (place + 1) for place, name in enumerate(_FIGURES)}
    return results.Result(pair, method, seed, figures=figures, **more)


_FIGURES = [
    "volume std",
    "volume max",
    *(f"{name} t={t}" for name in ("morph to shape", "shape to morph", "normal error") for t in (0, 1)),
    "most pieces",
    "fewest pieces",
    "gradient norm least",
    "gradient norm greatest",
    "roughness at 1/2",
]


def test_the_table_of_all_pairs_has_the_mean_and_the_range_of_the_seeds() -> None:
    found = [outcome("a_b", seed, scale, training_s=60.0, preparing_s=30.0) for seed, scale in enumerate((1, 2, 6))]
    table = goals_table([*found, outcome("a_b", None, 1.0, "official")], ["a_b", "c_d"], ["adadiv", "official"])
    assert list(table.rows) == ["a_b, adadiv", "a_b (official)"], "a pair without results has no row"
    assert table.cells["a_b, adadiv", "volume std"].mean == 3
    assert table.cells["a_b, adadiv", "volume std"].range == (1, 6)
    assert table.cells["a_b, adadiv", "minutes, fits included"].mean == 1.5
    assert ("a_b (official)", "minutes, fits included") not in table.cells
    assert not any("exact ends" in column.name for column in table.columns)


def test_the_table_of_all_pairs_shows_exact_ends_and_the_network_beside_each_other() -> None:
    network = outcome("a_b", 0, 100.0).figures
    rows = [outcome("a_b", 0, 1.0, network_figures=network), outcome("a_b", None, 1.0, "official")]
    table = goals_table(rows, ["a_b"], ["adadiv", "official"])
    ours = {head: cell.mean for (row, head), cell in table.cells.items() if row == "a_b, adadiv"}
    assert ours["distance, exact ends"] == 6, "the greatest of both ways and ends"
    assert ours["normals, exact ends (°)"] == 8
    assert ours["morph→shape t=0"] == 300
    assert ours["normals t=1 (°)"] == 800
    assert ours["most components"] == 9, "of the morph that a user sees"
    assert ("a_b (official)", "distance, exact ends") not in table.cells


_STEMS = [
    "tables/volume_std",
    "tables/volume_max",
    "tables/all",
    "pairs/disk_translation",
    "pairs/disk_translation_times",
]


def test_minutes_become_steps_by_the_time_of_one_and_stay_what_they_were(tmp_path: Path, started: list[Path]) -> None:
    job = Job("disk", "adadiv", 0, ("+experiment=disk_translation", "method=adadiv", *TINY, "seed=0"), tmp_path / "r")
    prepare(job, Budget(0.01, None), trained=True, threads=1, retry=False)
    assert run.carry_out({"folder": str(job.folder)}) == "done"
    record = read_record(job.folder)
    assert record is not None
    assert record.step_s is not None
    allowed = 0.6 / record.step_s
    assert record.steps is not None
    assert 0.9 * allowed <= record.steps <= max(1.0, allowed)
    assert started == [job.folder, job.folder]  # once to measure, once to train
    assert not (job.folder / "measure").exists()
    assert json.loads((job.folder / "summary.json").read_text())["steps"] == record.steps
    assert prepare(job, Budget(0.01, None), trained=True, threads=1, retry=True).steps == record.steps


@pytest.mark.parametrize(
    ("status", "said", "state", "reason"),
    [
        (2, "nsm: training collapsed twice\n", FAILED, "training collapsed twice"),
        (1, "Traceback (most recent call last):\nRuntimeError: no memory\n", FAILED, "RuntimeError: no memory"),
        (1, "", FAILED, "it ended with status 1 and without a summary"),
        (0, "", FAILED, "it ended with status 0 and without a summary"),
        (-signal.SIGKILL, "", INTERRUPTED, "its process was ended by SIGKILL, as happens where memory runs out"),
        (128 + signal.SIGTERM, "stopped", INTERRUPTED, "its process was ended by SIGTERM"),
    ],
)
def test_why_a_run_failed_is_kept(
    status: int, said: str, state: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        log.write_text(said)
        return status

    monkeypatch.setattr(run, "_start", fail)
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    budget = Budget(None, 3)
    prepare(job, budget, trained=True, threads=None, retry=False)
    assert run.carry_out({"folder": str(job.folder)}) == state
    assert read_record(job.folder).reason == reason  # type: ignore[union-attr]
    # what failed is not tried again unless asked for, what was ended from outside is
    assert prepare(job, budget, True, None, retry=False).state == (FAILED if state == FAILED else "planned")
    assert prepare(job, budget, True, None, retry=True).state == "planned"


def test_settings_may_change_until_a_run_has_begun(tmp_path: Path) -> None:
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    prepare(job, Budget(None, 3), True, None, retry=False)
    assert prepare(job, Budget(None, 5), True, None, retry=False).steps == 5
    (job.folder / "checkpoints").mkdir()
    changed = job._replace(overrides=("method=nise",))
    with pytest.raises(InputError, match="was begun with method=free where there is method=nise now"):
        prepare(changed, Budget(None, 5), True, None, retry=False)


class Lost:
    """A launcher whose worker dies."""

    def launch(self, *rest: Any, **more: Any) -> None:
        raise RuntimeError("a worker was lost")


def test_a_lost_worker_does_not_end_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare.Plugins, "instantiate_launcher", lambda self, **rest: Lost())
    assert compare_here(*tiny(tmp_path, "methods=[adadiv]")) == 0
    assert rows(tmp_path)["adadiv"]["reason"] == "it was left planned; repeat the command to go on"


def mark(config: Any) -> str:
    """In place of a run: leaves behind which process it would have been made by. Imports nothing of nsm."""
    import json
    import os
    from pathlib import Path

    record = Path(config["folder"]) / "run.json"
    content = json.loads(record.read_text()) | {"state": "failed", "reason": f"marked by {os.getpid()}"}
    record.write_text(json.dumps(content))
    return "failed"


@pytest.mark.parametrize("launcher", ["workers", "submitit"])
def test_runs_are_made_by_the_workers_of_a_launcher(
    launcher: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import tests
    monkeypatch.setattr(compare, "carry_out", mark)
    try:
        assert compare_here(*tiny(tmp_path), f"hydra/launcher={launcher}") == 0
    finally:
        cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    for method in ("adadiv", "free"):
        said = rows(tmp_path)[method]["reason"]
        assert said.startswith("marked by ")
        assert not said.startswith(f"marked by {os.getpid()};")


@pytest.mark.parametrize("launcher", ["workers", "submitit", "slurm"])
def test_every_launcher_composes(launcher: str) -> None:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("compare", ["+study=figure2", f"hydra/launcher={launcher}"], return_hydra_config=True)
    assert "hydra_plugins" in cfg.hydra.launcher._target_


# stopping it

#: In place of training: ticks until it is interrupted, and says so.
TICKER = """
import sys, time
from pathlib import Path
folder = Path([a for a in sys.argv if a.startswith("hydra.run.dir=")][0].partition("=")[2].strip("'"))
try:
    while True:
        (folder / "tick").write_text(str(time.time()))
        time.sleep(0.01)
except KeyboardInterrupt:
    (folder / "stopped").touch()
    sys.exit(130)
"""


def test_an_interrupt_lets_a_run_finish_its_step_and_the_study_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ticker.py").write_text(TICKER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(run, "COMMAND", "ticker")
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    budget = Budget(None, 3)
    prepare(job, budget, True, None, retry=False)

    def interrupt() -> None:
        wait_for((job.folder / "tick").is_file)
        time.sleep(1)  # a signal that comes before the main thread waits for the run would not wake it
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run.carry_out({"folder": str(job.folder)})
    thread.join()
    assert (job.folder / "stopped").is_file()
    assert prepare(job, budget, True, None, retry=False).state == "planned"


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + 120
    while not what():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_study_that_is_killed_takes_its_run_along_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    often = ["validations=250" if o.startswith("validations") else o for o in TINY]
    study = (*tiny(tmp_path, "methods=[adadiv]", "steps=1000"), f"overrides={json.dumps(often)}")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "nsm.compare", *study]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment)
    folder = tmp_path / "runs" / "disk_translation" / "adadiv"
    last = folder / "checkpoints" / "last.ckpt"
    wait_for(last.is_file, process)
    process.kill()
    process.communicate(timeout=60)
    time.sleep(0.3)
    kept = last.read_bytes()
    time.sleep(0.5)
    assert last.read_bytes() == kept  # nobody trains any more
    step = torch.load(last, weights_only=True)["global_step"]
    assert 0 < step < 1000
    record = read_record(folder)
    assert record is not None
    assert record.state == "training"

    steps: list[int] = []

    def resumed(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        assert "resume=true" in arguments
        steps.append(step)
        # as a run ends that had no more to do
        (log.parent / "summary.json").write_text('{"steps": 1000, "training_s": 1.0}')
        return 0

    monkeypatch.setattr(run, "_start", resumed)
    assert compare_here(*study) == 0
    assert steps == [step]
    assert rows(tmp_path)["adadiv"]["reason"] is None


def test_training_time_adds_up_over_sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 3.0, 10.0, 11.0, 12.0, 13.0])
    monkeypatch.setattr("nsm.train.callbacks.step_times.time.perf_counter", lambda: next(now))
    first, second = StepTimes(str(tmp_path)), StepTimes(str(tmp_path))
    trainer, module = mock.Mock(spec=L.Trainer), mock.Mock(spec=L.LightningModule)
    first.on_train_start(trainer, module)
    first.on_train_batch_end(trainer, module, None, None, 0)
    kept = first.state_dict()
    assert kept == {"seconds": 3.0}
    second.load_state_dict(kept)
    second.on_train_start(trainer, module)
    second.on_train_batch_end(trainer, module, None, None, 0)
    second.on_train_batch_end(trainer, module, None, None, 0)
    second.on_train_end(trainer, module)
    assert json.loads((tmp_path / "step_times.json").read_text()) == {
        "training_s": 6.0,
        "step_s": 1.0,
    }


# its tables

ROWS = ["adadiv", "no_eikonal", "lost"]
EXAMPLE = Table(
    "two figures",
    [Column("volume & std"), Column("slope", 1.0), Column("pieces", None, COUNT)],
    ROWS,
    {
        ("adadiv", "volume & std"): Cell(-0.00025),
        ("no_eikonal", "volume & std"): Cell(0.5),
        ("adadiv", "slope"): Cell(0.9, 0.01, 3, (0.89, 0.91)),
        ("no_eikonal", "slope"): Cell(2.0, 0.1, 3),
        ("adadiv", "pieces"): Cell(1.0),
        ("no_eikonal", "pieces"): Cell(2.0),
        ("lost", "slope"): Cell(float("nan")),
    },
)


def test_the_best_of_each_column_is_bold_and_what_is_missing_a_dash() -> None:
    assert markdown(EXAMPLE).splitlines()[2:] == [
        "| adadiv | **-0.000250** | **0.900 ± 0.0100 (0.890–0.910)** | 1 |",
        "| no_eikonal | 0.500 | 2.00 ± 0.100 | 2 |",
        "| lost | – | – | – |",
    ]


def test_what_reads_the_same_is_best_together_and_one_row_alone_is_not_best() -> None:
    column = Column("error")
    cells = {("a", "error"): Cell(0.10001), ("b", "error"): Cell(0.10002), ("c", "error"): Cell(0.2)}
    assert Table("", [column], ["a", "b", "c"], cells).best(column) == {"a", "b"}
    assert not Table("", [column], ["a"], cells).best(column)


def test_latex_is_balanced_and_escaped() -> None:
    lines = latex(EXAMPLE).splitlines()
    assert lines.count(r"\begin{tabular}{lrrr}") == lines.count(r"\end{tabular}") == 1
    rows = [line for line in lines if line.endswith(r" \\")]
    assert len(rows) == 1 + len(ROWS)
    for row in rows:
        assert len(re.findall(r"(?<!\\)&", row)) == 3
        assert row.count("{") == row.count("}")
        assert len(re.findall(r"(?<!\\)\$", row)) % 2 == 0
        assert not re.search(r"(?<!\\)[_%#]", row)
    assert r"volume \& std" in rows[0]
    assert r"\textbf{0.900 $\pm$ 0.0100 (0.890--0.910)}" in rows[1]


def test_csv_keeps_all_digits_and_both_numbers() -> None:
    table = list(csv.DictReader(comma_separated(EXAMPLE).splitlines()))
    assert table[0]["volume & std"] == "-0.00025"
    assert (table[1]["slope"], table[1]["slope std"], table[1]["slope min"]) == ("2", "0.1", "")
    assert (table[0]["slope min"], table[0]["slope max"]) == ("0.89", "0.91")
    assert table[2]["pieces"] == ""


def test_a_table_is_written_three_times(tmp_path: Path) -> None:
    files = write_table(tmp_path / "speed_1.5", EXAMPLE)
    assert [file.name for file in files] == ["speed_1.5.md", "speed_1.5.csv", "speed_1.5.tex"]
    assert all(file.stat().st_size for file in files)
