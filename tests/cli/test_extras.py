"""Without the packages of extras, the core works, and what needs them says so in one sentence."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from analytic import run_here, save, sentence, turning
from packaging.requirements import Requirement
from problems import Ball, LinearMotion
from runs import DISK, train_here

from nsm.cli.extras import MissingPackageError
from nsm.morphs.optimal_transport.entropic import entropic_maps
from nsm.plots.strip import render_strip, try_strip
from nsm.render.film import render_film
from nsm.train.callbacks import TensorBoardLog
from nsm.view import __main__ as view

ROOT = Path(__file__).resolve().parents[2]
#: What extras install, by the names under which it is imported.
EXTRAS = {
    "view": ["viser"],
    "render": ["embreex", "imageio_ffmpeg", "pyvista"],
    "track": ["tensorboard"],
    "ot": ["geomloss"],
    "usd": ["pxr"],
    "onnx": ["onnx", "onnxscript"],
    "medical": ["nibabel", "nrrd", "tifffile"],
    "svg": ["shapely", "svgelements"],
    "lidar": ["laspy"],
}
#: Names of distributions that differ from those of their modules.
DISTRIBUTIONS = {"pxr": "usd-core", "imageio_ffmpeg": "imageio-ffmpeg", "nrrd": "pynrrd"}


def strip(folder: Path) -> None:
    render_strip(folder / "strip.png", LinearMotion(Ball(3)), [0.0], size=40)


def film(folder: Path) -> None:
    render_film(folder / "film.mp4", LinearMotion(Ball(2)))


@pytest.mark.parametrize(
    ("package", "extra", "use"),
    [
        ("pyvista", "render", strip),
        ("embreex", "render", strip),
        ("imageio_ffmpeg", "render", film),
        ("geomloss", "ot", lambda folder: entropic_maps(torch.rand(3, 2), torch.rand(3, 2), 0.1, 0.5)),
        ("tensorboard", "track", lambda folder: TensorBoardLog(save_dir=str(folder))),
    ],
)
def test_a_missing_package_is_named_with_the_extra_that_installs_it(
    package: str, extra: str, use: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    pattern = rf"^\S.* needs `{package}`, which is not installed\. Try `pip install 'nsm\[{extra}\]'`\.$"
    with pytest.raises(MissingPackageError, match=pattern):
        use(tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_viewer_says_that_it_needs_viser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    file = save(turning(2, 0.1), tmp_path / "a.ckpt")
    assert run_here(view, f"checkpoint={file}") == 2
    assert "The viewer needs `viser`, which is not installed. Try `pip install 'nsm[view]'`." in sentence(
        capsys.readouterr().err
    )


def test_a_logger_that_is_not_installed_ends_training_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    assert train_here(*DISK, "logger=tensorboard", f"hydra.run.dir={tmp_path}") == 2
    assert "needs `tensorboard`, which is not installed. Try `pip install 'nsm[track]'`." in sentence(
        capsys.readouterr().err
    )


def test_training_without_a_renderer_leaves_the_strip_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    assert not try_strip(tmp_path / "strip.png", LinearMotion(Ball(3)), [0.0], size=40)
    assert "strip.png" in caplog.text
    assert "pip install 'nsm[render]'" in caplog.text


def test_the_core_needs_no_package_of_an_extra(tmp_path: Path) -> None:
    file = save(turning(3, 0.1), tmp_path / "a.ckpt")
    code = f"""
import sys
sys.modules |= dict.fromkeys({[name for names in EXTRAS.values() for name in names]})
import nsm
from nsm.train import __main__ as train, callbacks
from nsm.evaluate import __main__ as evaluate
from nsm.render import __main__ as render
from nsm.view import __main__ as view
from nsm.compare import __main__ as compare
morph = nsm.load_morph({str(file)!r}, ends="network")
print(morph.save({str(tmp_path / "a.glb")!r}, frames=2, resolution=12).name, morph.mesh(0.5, 12).is_watertight)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "a.glb True"


def test_extras_install_what_is_asked_for_and_all_installs_all_of_them() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert set(extras["all"][0].removeprefix("nsm[").removesuffix("]").split(",")) == set(EXTRAS)
    wanted = {DISTRIBUTIONS.get(name, name) for names in EXTRAS.values() for name in names}
    listed = {Requirement(line).name for name in EXTRAS for line in extras[name]}
    assert listed == wanted
    assert not listed & {Requirement(line).name for line in project["dependencies"]}
