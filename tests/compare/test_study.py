"""Whole studies, from the command to the report."""

from __future__ import annotations

import csv
import json
import os
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import pytest
from analytic import sentence
from studies import Lost, compare_here, rows, tiny

from nsm.compare import __main__ as compare
from nsm.compare import launch, measurement, run

_STEMS = [
    "tables/volume_std",
    "tables/volume_max",
    "tables/all",
    "pairs/disk_translation",
    "pairs/disk_translation_times",
]


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
    monkeypatch.setattr(measurement, "evaluate_morph", lambda *rest: pytest.fail("measured again"))
    del started[:]
    assert compare_here(*command) == 0
    assert not started
    assert rows(tmp_path) == found
    capsys.readouterr()

    # with another budget it is another study
    assert compare_here(*command, "steps=4") == 2
    assert "begun with steps=3 (now 4). Try" in sentence(capsys.readouterr().err)

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


def test_each_method_has_its_own_learning_rate_and_growth_and_its_course_is_shown(
    tmp_path: Path, started: list[Path]
) -> None:
    method = "{name: grown, method: adadiv, growth: scale_linear}"
    more = (f"methods=[{method}]", "learning_rates=[1e-6,1e-5]", "seeds=[0,1]", "slices.changes=1")
    pair = "pairs=[{name: growing, experiment: disk_translation, overrides: ['target.radius=0.45']}]"
    assert compare_here(*tiny(tmp_path, *more, pair)) == 0
    grown = tmp_path / "runs" / "growing" / "grown"
    found = json.loads((tmp_path / "study.json").read_text())["rows"]
    rate = found[0]["rate"]
    assert started == [grown / "lr_1e-06/seed_0", grown / "lr_1e-05/seed_0", grown / f"lr_{rate:g}/seed_1"]
    errors = {r: json.loads((grown / f"lr_{r:g}/seed_0/summary.json").read_text())["val/error"] for r in (1e-6, 1e-5)}
    assert errors[rate] == min(errors.values())
    assert [(row["seed"], row["rate"]) for row in found] == [(0, rate), (1, rate)]
    # f starts as the source at all times and is shown at the volumes of both disks
    for row in found:
        volumes = row["volume"]["volumes"]
        assert volumes[-1] / volumes[0] == pytest.approx(1.5**2, rel=0.05)
        assert row["figures"]["volume max"] < 0.05
        assert [point["step"] for point in row["course"]] == [1, 2, 3]
    page = (tmp_path / "README.md").read_text()
    assert "each method with its own best of the learning rates 1e-06, 1e-05" in page
    assert "(course_growing.png)" in page
    assert (tmp_path / "pairs" / "growing_rates.csv").is_file()


def test_a_lost_worker_does_not_end_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch.Plugins, "instantiate_launcher", lambda self, **rest: Lost())
    assert compare_here(*tiny(tmp_path, "methods=[adadiv]")) == 0
    assert rows(tmp_path)["adadiv"]["reason"] == "the run is planned; repeat the command to resume it"


def mark(config: Any) -> str:
    """In place of a run: leaves behind which process it would have been made by. Imports nothing of nsm."""
    import os
    from pathlib import Path

    record = Path(config["folder"]) / "run.json"
    content = json.loads(record.read_text()) | {"state": "failed", "reason": f"marked by {os.getpid()}"}
    changed = record.with_suffix(".changed")  # the study reads the record meanwhile
    changed.write_text(json.dumps(content))
    changed.replace(record)
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
