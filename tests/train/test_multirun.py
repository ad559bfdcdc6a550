"""Many runs at once."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import torch
from runs import BARE, train_here


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def test_a_multirun_ends_with_a_table_of_all_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = (*BARE, "steps=2", "validations=1", "velocity=free,adadiv", f"hydra.sweep.dir={tmp_path}")
    assert train_here("-m", *run) == 0
    folders = sorted(p.parent.relative_to(tmp_path) for p in tmp_path.rglob("summary.json"))
    assert len(folders) == 2
    with (tmp_path / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [Path(row["run"]) for row in rows] == folders
    assert [row["varied"] for row in rows] == ["velocity=free", "velocity=adadiv"]
    entries = [torch.load(tmp_path / f / "checkpoints" / "last.ckpt", weights_only=True)["nsm"] for f in folders]
    assert [e["config"]["velocity"]["_target_"] for e in entries] == ["nsm.fields.Free", "nsm.fields.AdaDiv"]
    for row in rows:
        summary = json.loads((tmp_path / row["run"] / "summary.json").read_text())
        assert float(row["val/error"]) == summary["val/error"]
    told = capsys.readouterr().out
    assert "2 runs in" in told
    table = told[told.index("2 runs in") :]
    assert "velocity=" in table
    assert all(header in table for header in ("error", "volume", "ends", "components"))
    assert "slope" not in table
    assert max(map(len, table.splitlines())) <= 80


def test_a_run_of_a_sweep_that_is_refused_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = (*BARE, "steps=2", "validations=1", "beta.alpha=-1,0.1", f"hydra.sweep.dir={tmp_path}")
    assert train_here("-m", *run) == 2
    assert "beta.alpha" in capsys.readouterr().err
    with (tmp_path / "summary.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 1
