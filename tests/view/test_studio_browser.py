"""What somebody sees who trains a morph on the page, in Chromium: two files, landmarks, progress, and the morph."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
import trimesh
from pages import studio_page
from playwright.sync_api import Locator, Page, ViewportSize
from runs import TINY

from nsm.shapes import LandmarkTable
from nsm.view.server import page_address
from nsm.view.studio import Studio

pytestmark = pytest.mark.usefixtures("no_complaints")

SIZE: ViewportSize = {"width": 760, "height": 320}
#: Where the shapes are on a page of that size.
FIRST, SECOND = (132, 205), (338, 190)
#: Milliseconds that a step may take: without a graphics card, a picture of the page takes up to some seconds.
PATIENCE = 120_000
#: A training of a few steps with two validations.
FEW = (*TINY, "callbacks=none", "steps=12", "validations=2", "trainer.log_every_n_steps=1", "optimizer.lr=1e-4")


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    few = [override for override in FEW if not override.startswith("callbacks.")]
    with studio_page(tmp_path_factory.mktemp("runs"), few, resolution=16, times=3) as studio:
        yield studio


@pytest.fixture(scope="module")
def page(studio: Studio, open_page: Callable[..., Page]) -> Page:
    page = open_page(page_address(studio.server), SIZE)
    page.set_default_timeout(PATIENCE)
    return page


def upload(page: Page, side: int, file: Path) -> None:
    page.locator("input[type=file]").nth(side).set_input_files(file)


def press(control: Locator) -> None:
    """Click without waiting for the pictures that the scene draws meanwhile."""
    control.evaluate("element => element.click()")


def wait_for_surfaces(page: Page, file: Path) -> None:
    """Wait until surfaces, which are blue, are where the shapes should be."""
    for _ in range(100):
        page.screenshot(path=file)
        pixels = imageio.imread(file)[..., :3].astype(int)
        if all(pixels[y, x, 2] - pixels[y, x, 0] > 24 for x, y in (FIRST, SECOND)):
            return
        page.wait_for_timeout(200)
    pytest.fail(f"the shapes do not appear: see {file}")


def test_from_two_files_to_a_morph(studio: Studio, page: Page, artefacts: Path, tmp_path: Path) -> None:
    ball, egg = trimesh.creation.icosphere(2, 5.0), trimesh.creation.icosphere(2, 5.0)
    ball.apply_translation([100, 0, 0])
    egg.apply_scale([1.0, 1.3, 1.0])
    ball.export(tmp_path / "ball.obj")
    egg.export(tmp_path / "my egg.stl")

    upload(page, 0, tmp_path / "ball.obj")
    upload(page, 1, tmp_path / "my egg.stl")
    for told in ("ball.obj: mesh in 3D", "my_egg.stl: mesh in 3D"):
        page.get_by_text(told).wait_for()

    press(page.get_by_role("checkbox"))
    wait_for_surfaces(page, artefacts / "studio_files.png")
    for number, place in enumerate((FIRST, SECOND)):
        page.mouse.move(*place)
        page.wait_for_timeout(300)
        page.mouse.click(*place)
        page.get_by_text(f"(1 on the first, {number} on the second shape)").wait_for()
    page.screenshot(path=artefacts / "studio_landmarks.png")

    press(page.get_by_role("button", name="Start training"))
    page.get_by_text(re.compile(r"step \d+ of 12 · loss")).wait_for()
    page.screenshot(path=artefacts / "studio_training.png")
    page.get_by_text("Training has finished.").wait_for()
    page.get_by_text("all 3 surfaces are ready").wait_for()
    page.screenshot(path=artefacts / "studio_morph.png")

    assert studio.result is not None
    folder = studio.result.folder
    pairs = LandmarkTable(str(folder / "landmarks.csv")).read(3)
    assert (pairs.source - torch.tensor([100.0, 0, 0])).norm().item() == pytest.approx(5, rel=0.05)
    assert (pairs.target / torch.tensor([1.0, 1.3, 1.0])).norm().item() == pytest.approx(5, rel=0.05)

    with page.expect_download() as download:
        press(page.get_by_role("button", name="Download GLB"))
    surface = trimesh.load(download.value.path(), file_type="glb", force="mesh")
    assert np.ptp(surface.vertices, axis=0) == pytest.approx([1.6] * 3, rel=0.5)
