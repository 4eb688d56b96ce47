"""The viewer in headless Chromium: the picture is the render, a click reads °C, buttons and drags move the camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest

from tdgbench.scenes import Camera
from tdgbench.view.cells import open_cells
from tdgbench.view.panel import readout
from tdgbench.view.poses import ViserPose, camera_of
from tdgbench.view.renderer import Look, RenderedLook, Renderer
from tests.helpers.browser import CHROMIUM, Page, opened
from tests.helpers.waiting import waited

pytest.importorskip("viser")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")]

LARGEST_CANVAS = "[...document.querySelectorAll('canvas')].sort((a, b) => b.offsetWidth - a.offsetWidth)[0]"
SIZE = f"(({{offsetWidth, offsetHeight}}) => [offsetWidth, offsetHeight])({LARGEST_CANVAS})"
VALUE = "document.getElementById('tdgbench-value')?.textContent"
PRESS = "[...document.querySelectorAll('button')].find((one) => one.textContent.includes('{}')).click()"


class Open(NamedTuple):
    """The viewer of two cells in a page."""

    page: Page
    server: object
    renderer: Renderer

    def expected(self, **look) -> RenderedLook:
        """What the page should show, from the camera that viser reports."""
        return self.renderer.render(Look("tdg", beside="msmg", **look), self.camera())

    def camera(self) -> Camera:
        """That of the page, over the pixels of its canvas."""
        (client,) = self.server.get_clients().values()
        pose = ViserPose(client.camera.wxyz, client.camera.position, client.camera.fov)
        return camera_of(pose, *self.page.run(SIZE))

    def position(self) -> np.ndarray:
        (client,) = self.server.get_clients().values()
        return client.camera.position

    def is_shown(self, frame: RenderedLook) -> bool:
        """Whether the page shows a frame; cameras and messages cover some of it."""
        height, width = frame.picture.shape[:2]
        shown = self.page.screenshot()[:height, :width].astype(int)
        difference = np.abs(shown - frame.picture)
        return np.median(difference) <= 2 and (difference.max(axis=2) > 12).mean() < 0.25


@pytest.fixture(scope="module")
def viewer(tdg_folder, msmg_folder, tmp_path_factory) -> Iterator[Open]:
    from tdgbench.view.server import Viewer, serving

    cells = open_cells([tdg_folder, msmg_folder])
    with serving("127.0.0.1", None) as server:
        running = Viewer(server, cells, width=1280)
        try:
            profile = tmp_path_factory.mktemp("chromium")
            with opened(f"http://127.0.0.1:{server.get_port()}", profile) as page:
                waited(server.get_clients, 90, "the page connects")
                page.wait_for("!!document.getElementById('tdgbench-value')", 90)
                yield Open(page, server, Renderer(cells))
        finally:
            running.close()


def test_the_page_shows_the_render_at_a_test_view(viewer, tmp_path):
    waited(lambda: viewer.is_shown(viewer.expected()), 60, "the picture is the render")
    camera = next(iter(viewer.renderer.cells["tdg"].test.values()))
    assert np.allclose(viewer.position(), camera.center, atol=1e-4)
    shown = viewer.page.screenshot(tmp_path / "viewer.png")
    assert shown.std() > 20 and (tmp_path / "viewer.png").stat().st_size > 20_000
    errors = [event for event in viewer.page.events if event["method"] == "Runtime.exceptionThrown"]
    assert errors == []


def test_a_click_reads_temperatures(viewer):
    frame = waited(lambda: viewer.is_shown(viewer.expected()) and viewer.expected(), 60, "the picture is the render")
    height, width = frame.picture.shape[:2]
    texts = set()
    for x, y in ((0.25, 0.5), (0.5, 0.5), (0.6, 0.8)):
        viewer.page.click(x * width, y * height)
        text = readout(frame.at(x, y), viewer.renderer.cells, "thermal")
        viewer.page.wait_for(f"({VALUE} ?? '').trim() === {text!r}", 20)
        texts.add(text)
    assert len(texts) > 1 and all("°C" in text for text in texts)


def test_a_button_leads_to_the_next_view_and_a_drag_away_from_it(viewer):
    cell = viewer.renderer.cells["tdg"]
    second = sorted(cell.test)[1]
    viewer.page.run(PRESS.format("next"))
    waited(lambda: np.allclose(viewer.position(), cell.test[second].center, atol=1e-4), 30, "the camera moves")
    waited(lambda: viewer.is_shown(viewer.expected()), 60, "the picture is the render")
    before = viewer.expected()
    for step in range(8):
        viewer.page.mouse("moved" if step else "pressed", 300 + 15 * step, 350, buttons=1)
    viewer.page.mouse("released", 405, 350)
    waited(lambda: not np.allclose(viewer.position(), cell.test[second].center, atol=0.05), 30, "the camera moves")
    waited(lambda: viewer.is_shown(viewer.expected()), 60, "the picture is the render")
    assert not viewer.is_shown(before)
