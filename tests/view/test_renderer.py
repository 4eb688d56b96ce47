"""What the viewer renders at a test view is the cell's stored render; looks are made of it."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from tdgbench.cells.read_files import read_picture
from tdgbench.cells.record import read_record
from tdgbench.cells.renders import render_model
from tdgbench.present.colours import colored, shaded
from tdgbench.scoring import to_8bit
from tdgbench.view.cells import open_cells
from tdgbench.view.panel import color_bar
from tdgbench.view.poses import camera_of, pose_of
from tdgbench.view.renderer import Look, Renderer, labelled, wiped


@pytest.fixture(scope="module")
def renderer(tdg_folder, msmg_folder) -> Renderer:
    return Renderer(open_cells([tdg_folder, msmg_folder]))


@pytest.fixture(scope="module")
def camera(renderer):
    """A test camera, on the way through viser's pose."""
    stored = next(iter(renderer.cells["tdg"].test.values()))
    return camera_of(pose_of(stored, stored.width / stored.height), stored.width, stored.height)


def stored(renderer, name: str, folder: str) -> np.ndarray:
    cell = renderer.cells[name]
    return read_picture(cell.cell.folder / folder / f"{next(iter(cell.test))}.png")


@pytest.mark.parametrize(
    ("name", "quantity", "folder"),
    [("tdg", "thermal", "renders"), ("msmg", "thermal", "renders"), ("msmg", "rgb", "renders_rgb")],
)
def test_a_test_view_is_the_stored_render(renderer, camera, name, quantity, folder):
    again = to_8bit(renderer.values(name, quantity, camera)).astype(int)
    expected = stored(renderer, name, folder)
    assert again.shape == expected.shape and expected.std() > 5
    assert np.abs(again - expected).max() <= 1


def test_pseudo_colour_is_shown_as_it_is(colour_folder):
    renderer = Renderer(open_cells([colour_folder]))
    stored_camera = next(iter(renderer.cells["tdg"].test.values()))
    frame = renderer.render(Look("tdg"), stored_camera)
    assert np.abs(frame.picture.astype(int) - stored(renderer, "tdg", "renders")).max() <= 1 and frame.whole is None


def test_gray_is_shown_in_a_colour_map_over_a_part_of_its_range(renderer, camera):
    frame = renderer.render(Look("tdg", colors="viridis", span=(0.25, 0.75)), camera)
    values = renderer.values("tdg", "thermal", camera)
    assert np.array_equal(frame.picture, colored(values[..., 0], "viridis", 0.25, 0.75)) and frame.whole == (0.0, 1.0)


def test_depth_and_alpha_are_the_model_s(renderer, camera):
    cell = renderer.cells["tdg"]
    render = render_model(cell.models["thermal"], camera, depth=True)
    alpha, depth = renderer.values("tdg", "alpha", camera), renderer.values("tdg", "depth", camera)
    assert np.allclose(alpha[..., 0], render.alpha, atol=1e-6)
    surface = render.alpha.numpy() > 0.5
    assert surface.mean() > 0.05 and np.array_equal(np.isfinite(depth[..., 0]), surface)
    expected = (render.requested_depth / render.alpha).numpy()
    assert np.allclose(depth[surface, 0], expected[surface], rtol=1e-5)
    low, high = renderer.depth_range()
    assert 0 < low < high and (depth[surface] > low / 2).all()
    assert renderer.render(Look("tdg", "depth"), camera).whole == (low, high)


def test_two_cells_are_divided_where_the_look_says(renderer, camera):
    frame = renderer.render(Look("tdg", beside="msmg", divide=0.25), camera)
    left, right = (renderer.render(Look(name), camera).picture for name in ("tdg", "msmg"))
    named = labelled(wiped(left, right, 0.25), 0.25, "tdg", "msmg")
    assert np.array_equal(frame.picture, named) and not np.array_equal(named[26:], wiped(left, right, 0.25)[26:])
    assert np.array_equal(frame.picture[:20, :12], left[:20, :12])
    assert np.array_equal(frame.picture[:20, 13:], right[:20, 13:])
    assert [name for name, _ in frame.at(0.5, 0.5)] == ["tdg", "msmg"]


def test_equal_temperatures_have_equal_colours_in_cells_of_two_ranges(tdg_folder, tmp_path):
    """The colour bar is of the first one."""
    copy = tmp_path / "other" / "cell"
    shutil.copytree(tdg_folder, copy)
    record = read_record(copy)
    replace(record, temperature_range=[0.0, 100.0]).write(copy)  # of 14 to 50 °C
    one, other = Renderer(open_cells([tdg_folder, copy])), next(iter(open_cells([tdg_folder]).values()))
    first, second = one.cells
    frame = one.render(Look(first, beside=second, span=(0.25, 0.75)), next(iter(other.test.values())))
    values = frame.parts[1].values[..., 0]
    low, high = ((14 + 36 * share) / 100 for share in (0.25, 0.75))  # °C of the bar's ends, in the range of the second
    assert np.array_equal(frame.parts[1].picture, colored(values, frame.look.colors, low, high))
    replace(record, temperature_range=None).write(copy)
    one = Renderer(open_cells([tdg_folder, copy]))
    frame = one.render(Look(first, beside=second, span=(0.25, 0.75)), next(iter(other.test.values())))
    own = colored(frame.parts[1].values[..., 0], frame.look.colors, 0.25, 0.75)
    assert np.array_equal(frame.parts[1].picture, own) and "°C" not in color_bar(frame, one.cells)


def test_a_cell_without_an_rgb_model_is_left_out_of_rgb(renderer, camera):
    frame = renderer.render(Look("tdg", "rgb", beside="msmg"), camera)
    assert [part.cell for part in frame.parts] == ["msmg"]
    with pytest.raises(ValueError, match="no cell has RGB"):
        renderer.render(Look("tdg", "rgb"), camera)


def test_a_pixel_is_read(renderer, camera):
    frame = renderer.render(Look("tdg"), camera)
    values = renderer.values("tdg", "thermal", camera)
    for x, y, row, column in ((0.0, 0.0, 0, 0), (1.0, 1.0, 35, 47), (0.5, 0.25, 9, 24), (-0.1, 2.0, 35, 0)):
        ((_, value),) = frame.at(x, y)
        assert np.array_equal(value, values[row, column])


def test_guesses_are_blue_as_far_as_training_views_do_not_determine_them(renderer, camera):
    plain, blue = (renderer.render(Look("tdg", guesses=guesses), camera).picture for guesses in (False, True))
    determinacy = renderer.determinacy("tdg", camera)
    assert np.ptp(determinacy) > 0.1 and np.array_equal(blue, shaded(plain, determinacy))
