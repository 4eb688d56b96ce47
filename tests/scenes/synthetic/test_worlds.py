import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.layouts import read_truth
from tests.helpers.scenes import small_dataset

OF_THE_PAPER = {  # group, channels; means of thermal images, RGB images and true depth; coordinates of the points
    "orbit": ("day", 3, (0.342397, 0.380762, 5.690734), (0.021753, -0.154948, 0.470129)),
    "night": ("dark", 3, (0.328680, 0.016902, 5.793532), (0.698804, 1.983175, 1.029345)),
    "turntable": ("360", 1, (0.299513, 0.354606, 4.513177), (0.003714, -0.139293, 0.449953)),
    "facade": ("forward", 1, (0.409151, 0.473738, 3.134044), (0.037880, -0.093089, 1.453600)),
}


def load(root, name, views=40, gradient_degC=0.0, **camera):
    errors = CaptureErrors(thermal_camera=ThermalErrors(**camera), gradient_degC=gradient_degC)
    return SyntheticDataset(str(root), ReadOptions(), 48, 36, views, 50 * views, errors=errors).load(name)


@pytest.mark.parametrize("name", OF_THE_PAPER)
def test_scenes_of_the_paper_s_groups_are_as_before(data_root, name):
    """Means, since the last bits of an exponential, and so the hash of a scene, differ between processors."""
    scene, (group, channels, means, middle) = small_dataset(data_root).load(name), OF_THE_PAPER[name]
    images = [[np.mean(image) for image in (view.thermal, view.rgb, view.true_depth)] for view in scene.views]
    assert (scene.group, scene.channels) == (group, channels)
    assert np.allclose(np.mean(images, axis=0), means, atol=1e-4)
    assert np.allclose(scene.points.points.mean(0), middle, atol=1e-4)


@pytest.mark.parametrize("name", WORLDS)
def test_depth_agrees_with_the_sparse_points(data_root, name):
    """Points, projected into a view, are at its depth there or hidden: cameras, depth and model agree."""
    scene = small_dataset(data_root).load(name)
    for view in scene.views[::4]:
        pixels, z = view.camera.project(scene.points.points)
        inside = (z > 0) & (pixels >= 1).all(axis=1) & (pixels < [47, 35]).all(axis=1)
        columns, rows = pixels[inside].astype(int).T
        near, far = (kind(view.true_depth, 3)[rows, columns] for kind in (minimum_filter, maximum_filter))
        assert (z[inside] > near * 0.97).mean() > 0.95  # nothing floats before the surfaces, but for outliers
        assert ((z[inside] > near * 0.97) & (z[inside] < far * 1.03)).mean() > 0.5


def test_half_seen_is_trained_and_reconstructed_from_one_side_and_tested_from_both(data_root):
    scene = small_dataset(data_root).load("half_seen")
    sides = {part: [view.camera.center[1] for view in getattr(scene, part)] for part in ("train", "test")}
    assert max(sides["train"]) < 0 and min(sides["test"]) < -5 and max(sides["test"]) > 5
    points = scene.points.points
    on_house = (np.abs(points[:, 0]) < 1.7) & (points[:, 2] > 0.1) & (points[:, 2] < 2.1)
    front, back = (np.sum(on_house & (np.abs(points[:, 1] - y) < 0.1)) for y in (-1.3, 1.3))
    assert front > 20 and back < 0.1 * front


def left_of_a_linear_vignette(scene, axis):
    """Share of a vignette linear in x or y that offsets linear in the camera's place and a gradient do not explain."""
    places, terms = [], []
    for view in scene.views:  # what it sees of the sparse points
        pixels, z = view.camera.project(scene.points.points)
        inside = view.camera.holds(pixels, z)
        columns, rows = pixels[inside].astype(int).T
        seen = np.flatnonzero(inside)[np.abs(z[inside] / view.true_depth[rows, columns] - 1) < 0.03]
        places.append(pixels[seen, axis])
        cameras = np.tile(view.camera.center, (len(seen), 1))
        terms.append(np.column_stack([cameras, scene.points.points[seen], np.ones(len(seen))]))
    vignette, terms = np.concatenate(places) - np.concatenate(places).mean(), np.concatenate(terms)
    left = vignette - terms @ np.linalg.lstsq(terms, vignette, rcond=None)[0]
    return left.std() / vignette.std()


@pytest.mark.parametrize(
    ("name", "least", "most"), [("field", 0, 0.01), ("wall", 0, 0.03), ("hills", 0.02, 0.1), ("turntable", 0.5, 1)]
)
def test_along_a_surface_linear_parts_of_vignette_offsets_and_scene_cancel(data_root, name, least, most):
    scene = small_dataset(data_root).load(name)
    assert all(least <= left_of_a_linear_vignette(scene, axis) < most for axis in (0, 1))


@pytest.mark.parametrize("name", ["field", "hills", "wall"])
def test_views_overlap_and_come_in_the_order_of_flight(tmp_path, name):
    scene = load(tmp_path, name)
    seen = np.sum([view.camera.shows(scene.points.points) for view in scene.views], axis=0)
    assert np.mean(seen >= 5) > 0.85 and np.median(seen) >= 10
    steps = np.linalg.norm(np.diff([view.camera.center for view in scene.views], axis=0), axis=1)
    assert len(scene.views) == 40 and steps.max() < 2 * steps.min()  # lines lie as close as views; no way back
    assert scene.group == "" and scene.channels == 1


def test_drift_and_shutter_follow_the_flight(tmp_path):
    scene = load(tmp_path, "field", walk_degC=4.0, shutter_views=10)
    truth, (low, high) = read_truth(scene.folder), (scene.temperature.min, scene.temperature.max)
    added = [low + (high - low) * np.mean(view.thermal) - view.true_temperature.mean() for view in scene.views]
    assert truth.names == [view.name for view in scene.views]
    assert added == pytest.approx(truth.camera.offsets, abs=0.01)
    assert np.allclose(truth.camera.offsets[::10], truth.camera.offsets[0])


@pytest.mark.parametrize("name", ["field", "wall"])
def test_a_gradient_is_linear_from_end_to_end(tmp_path, name):
    flat, warmer = (load(tmp_path, name, 10, degC, encoding="degC") for degC in (0.0, 6.0))
    low, high = flat.temperature.min, flat.temperature.max
    assert (warmer.temperature.min, warmer.temperature.max) == (low - 3, high + 3)
    added, x = [], []
    for before, after in zip(flat.views, warmer.views, strict=True):
        camera = before.camera
        assert np.abs(camera.world_to_camera[0, :3] - [1, 0, 0]).max() < 0.01  # images have the world's x to the right
        x.append(camera.center[0] + (np.arange(48) + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * before.true_depth)
        added.append(after.true_temperature - before.true_temperature)
    slope, at_zero = np.polyfit(np.ravel(x), np.ravel(added), 1)
    length = WORLDS[name](0).length
    assert slope * length == pytest.approx(6, rel=0.01) and at_zero == pytest.approx(0, abs=0.05)
    assert np.ptp(x) == pytest.approx(length, rel=0.05)


def test_worlds_without_a_long_axis_have_no_gradient(tmp_path):
    plain, asked = load(tmp_path, "turntable", 10), load(tmp_path, "turntable", 10, 6.0)
    assert asked.fingerprint == plain.fingerprint and asked.folder != plain.folder
