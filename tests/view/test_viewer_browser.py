"""What somebody sees who opens the viewer's page, or a recording, in Chromium."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from analytic import shrinking
from pages import shown
from playwright.sync_api import Page

from nsm.io.loading import LoadedMorph
from nsm.view.page import Viewer
from nsm.view.pictures import Settings
from nsm.view.recording import record
from nsm.view.server import page_address

SETTINGS = Settings(resolution=12)
TIMES = [0.0, 0.25, 0.5, 0.75, 1.0]
#: Rows and columns of a page that hold nothing but the scene.
SCENE = (340, 450)
pytestmark = pytest.mark.usefixtures("no_complaints")


def loaded_morphs(count: int, dim: int = 3) -> list[LoadedMorph]:
    return [LoadedMorph(f"ball {n}", "", shrinking(dim, 0.3 + 0.1 * n), None) for n in range(count)]


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with shown(loaded_morphs(2), SETTINGS, TIMES, seconds=2.0) as viewer:
        yield viewer


@pytest.fixture(scope="module")
def page(viewer: Viewer, open_page: Callable[..., Page]) -> Page:
    page = open_page(page_address(viewer.server))
    page.get_by_text("all 10 surfaces are ready").wait_for()
    return page


def picture(page: Page, file: Path) -> np.ndarray:
    """The scene (h, w, 3), without the controls."""
    page.screenshot(path=file)
    return imageio.imread(file)[..., :3].astype(int)[: SCENE[0], : SCENE[1]]


def colored(image: np.ndarray) -> int:
    """Pixels of a surface: blue, where floor, labels and page are grey; the page comes up slowly from white."""
    return int((image[..., 2] - image[..., 0] > 24).sum())


def settled(page: Page, file: Path, accept: Callable[[np.ndarray], bool]) -> np.ndarray:
    """The scene once it is as it should be."""
    for _ in range(40):
        image = picture(page, file)
        if accept(image):
            return image
        page.wait_for_timeout(200)
    pytest.fail(f"the scene did not change: see {file}")


def figures(page: Page, row: str) -> list[str]:
    return page.get_by_role("row", name=re.compile(rf"^{row}")).get_by_role("cell").all_inner_texts()[1:]


def test_the_slider_changes_the_surfaces_and_their_volumes(page: Page, artefacts: Path) -> None:
    first = settled(page, artefacts / "start.png", lambda image: colored(image) > 1000)
    volumes = [float(text) for text in figures(page, "volume")]
    assert len(volumes) == 2
    assert figures(page, "deviation") == ["+0.00 %", "+0.00 %"]
    assert figures(page, "components") == ["1", "1"]

    page.get_by_role("slider").first.press("End")
    page.wait_for_function("() => !document.body.innerText.includes('+0.00 %')")
    assert all(float(now) < 0.8 * then for now, then in zip(figures(page, "volume"), volumes, strict=True))
    settled(page, artefacts / "end.png", lambda image: colored(image) < 0.9 * colored(first))


def test_play_moves_time_for_everybody_who_looks(viewer: Viewer, page: Page, open_page: Callable[..., Page]) -> None:
    other = open_page(page_address(viewer.server), {"width": 700, "height": 200})
    page.get_by_role("slider").first.press("Home")
    page.get_by_role("button", name="Play").click()
    for watched in (page, other):
        watched.get_by_role("button", name="Pause").wait_for()
        watched.wait_for_function("() => document.querySelector('[role=slider]').getAttribute('aria-valuenow') > 0.3")
    other.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for()


def test_a_flat_morph_is_filled_and_takes_colors(open_page: Callable[..., Page], artefacts: Path) -> None:
    with shown(loaded_morphs(1, dim=2), SETTINGS, TIMES) as viewer:
        page = open_page(page_address(viewer.server))
        settled(page, artefacts / "flat.png", lambda image: colored(image) > 1000)
        page.get_by_label("Shows").click()
        page.get_by_role("option", name="Eikonal residual").click()
        page.get_by_text("zero for a distance").wait_for()
        settled(page, artefacts / "eikonal.png", lambda image: bool((image[..., 1] - image[..., 2] > 40).any()))


def test_a_recording_plays_from_the_file_alone(open_page: Callable[..., Page], artefacts: Path, tmp_path: Path) -> None:
    for _ in record(tmp_path / "morph.html", loaded_morphs(2), SETTINGS, TIMES, seconds=2.0):
        pass
    # small, as the page draws all the time; the warning of slow drawing on the left and the bar of the player stay out
    page = open_page((tmp_path / "morph.html").as_uri(), {"width": 600, "height": 300})
    shown = lambda image: colored(image[:230, 310:])  # noqa: E731
    seen: list[int] = []
    settled(page, artefacts / "recording.png", lambda image: shown(image) > 300)
    for _ in range(40):
        seen.append(shown(picture(page, artefacts / "recording.png")))
        if min(seen) < 0.9 * max(seen):
            return
        page.wait_for_timeout(100)
    pytest.fail(f"the recording stands still: {seen}")
