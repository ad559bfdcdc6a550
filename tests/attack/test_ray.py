"""A study is run by Ray, whose launcher needs an environment of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest
from nightly import NIGHTLY
from runs import BARE

from nsm.compare.record import DONE, read_record

ROOT = Path(__file__).resolve().parents[2]
#: A study so small that a run takes a second.
SMALL = (
    "+study=figure2",
    "methods=[adadiv,free]",
    "learning_rates=null",
    "seeds=[0]",
    "minutes=null",
    "steps=3",
    "threads=1",
    "volume_resolution=16",
    "surface_resolution=16",
    "times=3",
    "samples=500",
    "strip_times=[0,1]",
    "picture_size=24",
    "hydra/launcher=ray_workers",
    "hydra.launcher.ray.remote.num_cpus=1",
)


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment that holds what ``nsm[ray]`` needs, before the packages of this one."""
    folder = tmp_path_factory.mktemp("ray")
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "pinned.pth").write_text(sysconfig.get_path("purelib"))
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    install = [folder / "bin" / "python", "-m", "pip", "install", "-qq", "--no-input", *extras["ray"], "cloudpickle<3"]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"Ray cannot be installed here: {done.stderr.strip().splitlines()[-1]}")
    return folder / "bin" / "python"


@pytest.mark.skipif(not NIGHTLY, reason="installs Ray: make nightly")
def test_a_study_is_run_by_ray(python: Path, tmp_path: Path) -> None:
    tiny = [o for o in BARE if not o.startswith(("+experiment", "steps", "threads", "callbacks"))]
    command = [python, "-m", "nsm.compare", *SMALL, f"output={tmp_path / 'study'}", f"overrides={json.dumps(tiny)}"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "HOME": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Started a local Ray instance" in done.stderr
    folders = [file.parent for file in (tmp_path / "study" / "runs").rglob("run.json")]
    assert [read_record(folder).state for folder in folders] == [DONE, DONE]  # type: ignore[union-attr]
