"""A session with a server of viser in the place of a client, whose camera is written by the test."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tdgbench.view.cells import open_cells
from tdgbench.view.poses import camera_of, pose_of, thumbnails
from tdgbench.view.renderer import Look, Renderer
from tdgbench.view.requests import Requests

pytest.importorskip("viser")


@dataclass
class Camera:
    """What a session reads and writes of viser's camera."""

    wxyz: np.ndarray = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    look_at: np.ndarray = field(default_factory=lambda: np.zeros(3))
    fov: float = 1.0
    image_width: int = 640
    image_height: int = 480
    moved: list[Callable] = field(default_factory=list)

    @property
    def aspect(self) -> float:
        return self.image_width / self.image_height

    def on_update(self, callback: Callable) -> None:
        self.moved.append(callback)

    def move(self) -> None:
        for callback in self.moved:
            callback(self)


@pytest.fixture(scope="module")
def cells(tdg_folder, msmg_folder):
    return open_cells([tdg_folder, msmg_folder])


@pytest.fixture
def client() -> Iterator[SimpleNamespace]:
    from tdgbench.view.server import serving

    with serving("127.0.0.1", 0) as server:
        yield SimpleNamespace(
            camera=Camera(), gui=server.gui, scene=server.scene, client_id=7, atomic=nullcontext, flush=lambda: None
        )


@pytest.fixture
def session(client, cells):
    from tdgbench.view.session import Session, Shown

    return Session(client, Shown(cells, thumbnails(cells["tdg"]), 320), Requests(rest=0))


def all_wanted(session) -> list:
    return [job.wanted for job in iter(session._requests.take, None)]


def test_it_begins_at_the_first_test_view_with_both_cells(session, client, cells):
    view, camera = sorted(cells["tdg"].test.items())[0]
    pose = pose_of(camera, 640 / 480)
    assert np.allclose(client.camera.position, pose.position) and np.allclose(client.camera.wxyz, pose.wxyz)
    ahead = client.camera.look_at - pose.position
    assert np.allclose(ahead / np.linalg.norm(ahead), camera.world_to_camera[2, :3])
    (wanted,) = all_wanted(session)
    assert wanted.look == Look("tdg", beside="msmg") and (wanted.width, wanted.height) == (320, 240)
    assert session.panel.views[0] == view and len(session.panel.views) == 10


def test_a_window_of_another_shape_still_shows_all_of_the_view(session, client, cells):
    camera = sorted(cells["tdg"].test.items())[0][1]
    client.camera.image_width = 240
    client.camera.move()
    assert client.camera.fov == pose_of(camera, 0.5).fov
    client.camera.fov, client.camera.position, client.camera.image_width = 0.7, np.ones(3), 960
    client.camera.move()
    assert client.camera.fov == 0.7  # it has left the view


def test_a_page_that_reports_the_view_it_left_is_sent_on(session, client, cells):
    """A second click while the page still reports where it was: viser takes the goal for reached, and sends nothing."""
    first, second = (cells["tdg"].test[view].center for view in sorted(cells["tdg"].test)[:2])
    for step in (1, -1):
        session.step(step)
    client.camera.position = second  # the page has caught up with the first click only
    client.camera.move()
    assert np.allclose(client.camera.position, first)
    client.camera.position = first + 0.2
    client.camera.move()
    assert np.allclose(client.camera.position, first + 0.2)  # dragged away
    client.camera.position = cells["tdg"].cameras[session.panel.views[2]].center
    client.camera.move()
    assert not np.allclose(client.camera.position, first)


def test_clicks_at_once_are_steps_in_turn(session, cells, monkeypatch):
    show_view = session.panel.show_view
    monkeypatch.setattr(session.panel, "show_view", lambda view: (time.sleep(0.05), show_view(view)))
    with ThreadPoolExecutor(3) as threads:
        list(threads.map(session.step, (1, 1, 1, -1, 1)))
    assert session.panel._view.value.split()[0] == session.panel.views[3]
    assert np.allclose(session.client.camera.position, cells["tdg"].cameras[session.panel.views[3]].center)


def test_a_pixel_of_a_frame_is_read(session, client, cells):
    (wanted,) = all_wanted(session)
    frame = Renderer(cells).render(wanted.look, camera_of(wanted.pose, wanted.width, wanted.height))
    session.read_at(0.5, 0.5)  # there is no frame yet
    session.show(frame, is_fine=False)
    assert "°C" not in session.panel.readout.content
    session.read_at(0.5, 0.5)
    assert session.panel.readout.content.count("°C") == 2
    session.show(frame, is_fine=True)
    low, high = cells["tdg"].degC
    assert f"{low:.1f} °C" in session.panel._bar.content and f"{high:.1f} °C" in session.panel._bar.content


def test_choices_are_looks(session, client):
    all_wanted(session)
    panel = session.panel
    for control, value in ((panel._beside, "–"), (panel._quantity, "depth"), (panel._span, (20, 80))):
        control.value = value
    assert panel.look() == Look("tdg", "depth", span=(0.2, 0.8))
    assert "RGB" in panel._quantity.options


def test_what_a_method_renders_beside_its_thermal_model_can_be_shown(client, cells):
    from tdgbench.view.session import Session, Shown

    several = SimpleNamespace(modalities=("thermal", "rgb"))
    one = {"one": replace(cells["tdg"], method=several)}
    panel = Session(client, Shown(one, thumbnails(cells["tdg"]), 320), Requests(rest=0)).panel
    assert "RGB" in panel._quantity.options


def test_a_view_shows_its_ground_truth(session, cells):
    test, train = sorted(cells["tdg"].test)[1], sorted(cells["tdg"].train)[0]
    session.go_to(test)
    assert all(image.visible for image in session.panel._images.values())
    assert session.panel._images["thermal"].image.std() > 5
    session.go_to(train)
    assert not any(image.visible for image in session.panel._images.values())
    assert session.panel._view.value == f"{train} (training)"


def test_a_picture_that_is_lost_meanwhile_is_told(session, cells, monkeypatch):
    def lost(*_):
        raise ValueError("view.png cannot be read")

    monkeypatch.setattr(type(cells["tdg"]), "pictures", lost)
    session.go_to(sorted(cells["tdg"].test)[1])
    assert "view.png cannot be read" in session.panel.readout.content
    assert not any(image.visible for image in session.panel._images.values())


def test_names_are_text(session):
    session.panel.show_value("<b>tdg")
    assert "&lt;b&gt;tdg" in session.panel.readout.content and "<b>tdg" not in session.panel.readout.content
