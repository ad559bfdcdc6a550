"""The gallery draws runs that are given, and trains the pairs that are missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from analytic import save, turning
from runs import BARE

from nsm.cli.configuration import CONF

ROOT = Path(__file__).resolve().parents[2]


def gallery(folder: Path, *arguments: str) -> str:
    command = [sys.executable, str(ROOT / "tools" / "gallery.py"), *arguments, "--page", "gallery.md"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "NSM_CACHE_DIR": str(folder / "c")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return (folder / "gallery.md").read_text()


def test_runs_that_are_given_are_drawn(tmp_path: Path) -> None:
    for pair, dim in (("kitten_fandisk", 3), ("disk_translation", 2)):
        save(turning(dim, 0.1), tmp_path / "runs" / pair / "adadiv" / "0" / "checkpoints" / "best.ckpt")
    page = gallery(tmp_path, "--runs", "runs", "--pairs", "kitten_fandisk", "disk_translation", "--resolution", "24")
    for pair in ("kitten_fandisk", "disk_translation"):
        assert f"(gallery/{pair}.png)" in page
        assert (tmp_path / "gallery" / f"{pair}.png").stat().st_size > 1000
    assert "## Kitten → fandisk" in page
    assert page.count("The volume deviates by at most ") == 2
    assert not (tmp_path / "outputs").exists()


def test_a_pair_without_a_run_is_trained(tmp_path: Path) -> None:
    small = [override for override in BARE if not override.startswith(("+experiment", "callbacks"))]
    page = gallery(tmp_path, *small, "--pairs", "square_rectangle", "--resolution", "24")
    assert (tmp_path / "outputs" / "gallery" / "square_rectangle" / "checkpoints" / "best.ckpt").is_file()
    assert "nsm train +experiment=square_rectangle" in page


def test_there_are_at_least_eight_pairs_and_all_are_experiments() -> None:
    command = [sys.executable, "-c", "import gallery; print(*gallery.PAIRS)"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    shown = subprocess.run(command, cwd=ROOT / "tools", env=environment, capture_output=True, text=True, check=True)
    pairs = shown.stdout.split()
    assert len(set(pairs)) >= 10
    assert all((CONF / "experiment" / f"{pair}.yaml").is_file() for pair in pairs)
