"""The gallery draws runs that are given, and trains the pairs that are missing."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

from analytic import save, turning
from runs import BARE

from nsm.cli.configuration import CONF

ROOT = Path(__file__).resolve().parents[2]


def test_runs_that_are_given_are_drawn_and_others_are_trained(tmp_path: Path) -> None:
    save(turning(2, 0.1), tmp_path / "runs" / "disk_translation" / "adadiv" / "0" / "checkpoints" / "best.ckpt")
    small = [override for override in BARE if not override.startswith(("+experiment", "callbacks"))]
    pairs = ("--pairs", "disk_translation", "square_rectangle", "--resolution", "24")
    command = [
        sys.executable,
        str(ROOT / "tools" / "gallery.py"),
        *small,
        "--runs",
        "runs",
        *pairs,
        "--page",
        "page.md",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "NSM_CACHE_DIR": str(tmp_path / "c")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "page.md").read_text()
    for pair in ("disk_translation", "square_rectangle"):
        assert f"(page/{pair}.png)" in page
        assert f"nsm train +experiment={pair}" in page
        assert (tmp_path / "page" / f"{pair}.png").stat().st_size > 1000
    assert page.count("The volume deviates by at most ") == 2
    assert [run.name for run in (tmp_path / "outputs" / "gallery").iterdir()] == ["square_rectangle"]
    assert (tmp_path / "outputs" / "gallery" / "square_rectangle" / "checkpoints" / "best.ckpt").is_file()


def test_there_are_at_least_ten_pairs_and_all_are_experiments() -> None:
    with mock.patch.object(sys, "path", [str(ROOT / "tools"), *sys.path]):
        pairs = importlib.import_module("gallery").PAIRS
    assert len(set(pairs)) >= 10
    assert all((CONF / "experiment" / f"{pair}.yaml").is_file() for pair in pairs)
