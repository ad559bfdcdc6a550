"""What somebody sees who trains a morph on the page, in Chromium: two files, landmarks, progress, and the morph."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import imageio.v3 as imageio
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

SIZE: ViewportSize = {"width": 620, "height": 240}
#: Where the shapes are on a page of that size.
FIRST, SECOND = (78, 150), (234, 150)
#: Where the surfaces of a validation are on it.
STRIP = [(x, 134) for x in (28, 88, 148, 207, 266)]
#: Milliseconds that a step may take: without a graphics card, a picture of the page takes up to some seconds.
PATIENCE = 120_000
#: A training that only the button ends, with its first validation after a few steps.
LONG = (*TINY, "callbacks=none", "steps=100000", "validations=2000", "optimizer.lr=1e-4")


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    long = [override for override in LONG if not override.startswith("callbacks.")]
    with studio_page(tmp_path_factory.mktemp("runs"), long, resolution=16, times=3) as studio:
        yield studio


@pytest.fixture(scope="module")
def page(studio: Studio, open_page: Callable[..., Page]) -> Page:
    page = open_page(page_address(studio.server), SIZE)
    page.set_default_timeout(PATIENCE)
    press(page.get_by_role("alert").get_by_role("button"))  # it warns that pictures are slow, and hides shapes
    return page


def drop(page: Page, side: int, file: Path) -> None:
    """Drag a file over the area of a shape and drop it there, as the browser's own input does."""
    target = page.locator("input[type=file]").nth(side)
    target.wait_for()
    area = target.bounding_box()
    assert area is not None
    x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
    devtools = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(file)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        devtools.send("Input.dispatchDragEvent", {"type": kind, "x": x, "y": y, "data": data})


def press(control: Locator) -> None:
    """Click without waiting for the pictures that the scene draws meanwhile."""
    control.evaluate("element => element.click()")


def wait_for_surfaces(page: Page, file: Path, places: Iterable[tuple[int, int]]) -> None:
    """Wait until surfaces, which are blue, are at some places of the page."""
    for _ in range(30):
        page.screenshot(path=file)
        pixels = imageio.imread(file)[..., :3].astype(int)
        if all(pixels[y, x, 2] - pixels[y, x, 0] > 24 for x, y in places):
            return
        page.wait_for_timeout(200)
    pytest.fail(f"the surfaces do not appear: see {file}")


def test_from_two_files_to_a_morph(studio: Studio, page: Page, artefacts: Path, tmp_path: Path) -> None:
    ball, egg = trimesh.creation.icosphere(2, 5.0), trimesh.creation.icosphere(2, 5.0)
    ball.apply_translation([100, 0, 0])
    egg.apply_scale([1.0, 1.3, 1.0])
    ball.export(tmp_path / "ball.obj")
    egg.export(tmp_path / "my egg.stl")

    drop(page, 0, tmp_path / "ball.obj")
    page.locator("input[type=file]").nth(1).set_input_files(tmp_path / "my egg.stl")
    for told in ("ball.obj: mesh in 3D", "my_egg.stl: mesh in 3D"):
        page.get_by_text(told).wait_for()

    press(page.get_by_role("checkbox"))
    wait_for_surfaces(page, artefacts / "studio_files.png", (FIRST, SECOND))
    for place, told in ((FIRST, "1 on the first shape, 0 on the second"), (SECOND, "1 pair")):
        page.mouse.move(*place)
        page.wait_for_timeout(300)
        page.mouse.click(*place)
        page.get_by_text(told).wait_for()
    with page.expect_download() as download:
        press(page.get_by_role("button", name="Save as CSV"))
    page.screenshot(path=artefacts / "studio_landmarks.png")

    press(page.get_by_role("button", name="Start training"))
    page.get_by_text("volume within ±").wait_for()
    assert re.search(r"step \d+ of 100000 · loss", page.inner_text("body"))
    wait_for_surfaces(page, artefacts / "studio_training.png", STRIP)
    press(page.get_by_role("button", name="Stop and keep"))
    page.get_by_text("Training was stopped.").wait_for()
    page.get_by_text("all 3 surfaces are ready").wait_for()
    page.screenshot(path=artefacts / "studio_morph.png")

    assert studio.result is not None
    kept = studio.result.folder / "landmarks.csv"
    assert kept.read_bytes() == Path(download.value.path()).read_bytes()
    pairs = LandmarkTable(str(kept)).read(3)
    assert (pairs.source - torch.tensor([100.0, 0, 0])).norm().item() == pytest.approx(5, rel=0.05)
    assert (pairs.target / torch.tensor([1.0, 1.3, 1.0])).norm().item() == pytest.approx(5, rel=0.05)

    press(page.get_by_role("button", name="New morph"))
    page.get_by_text("Both shapes are there.").wait_for()
