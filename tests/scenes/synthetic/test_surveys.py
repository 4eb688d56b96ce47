import numpy as np
import pytest

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.truth import read_truth
from tests.helpers.scenes import small_dataset

FULL = {"width": 48, "height": 36, "views": 40, "points": 2000}  # as many views as the default


def load(root, name, **camera):
    errors = CaptureErrors(thermal_camera=ThermalErrors(**camera))
    return SyntheticDataset(str(root), ReadOptions(), **FULL, errors=errors).load(name)


def observations(scene):
    """Places in the image (N, 2), cameras (N, 3) and points (N, 3) of what the views see of the sparse points."""
    found = []
    for view in scene.views:
        pixels, z = view.camera.project(scene.points.points)
        inside = (z > 0) & (pixels >= 0).all(axis=1) & (pixels < [view.camera.width, view.camera.height]).all(axis=1)
        columns, rows = pixels[inside].astype(int).T
        seen = np.flatnonzero(inside)[np.abs(z[inside] / view.true_depth[rows, columns] - 1) < 0.03]
        cameras = np.tile(view.camera.center, (len(seen), 1))
        found.append((pixels[seen], cameras, scene.points.points[seen]))
    return (np.concatenate(part) for part in zip(*found, strict=True))


def left_of_a_linear_vignette(scene, axis):
    """Share of a vignette linear in x or y that offsets linear in the camera's place and a gradient do not explain."""
    pixels, cameras, points = observations(scene)
    vignette = pixels[:, axis] - pixels[:, axis].mean()
    terms = np.concatenate([cameras, points, np.ones((len(points), 1))], axis=1)
    left = vignette - terms @ np.linalg.lstsq(terms, vignette, rcond=None)[0]
    return left.std() / vignette.std()


@pytest.mark.parametrize(
    ("name", "least", "most"), [("field", 0, 0.01), ("wall", 0, 0.03), ("hills", 0.02, 0.1), ("turntable", 0.5, 1)]
)
def test_along_a_surface_linear_parts_of_vignette_offsets_and_scene_cancel(data_root, name, least, most):
    scene = small_dataset(data_root).load(name)
    for axis in (0, 1):
        assert least <= left_of_a_linear_vignette(scene, axis) < most


@pytest.mark.parametrize("name", ["field", "hills", "wall"])
def test_views_overlap_and_come_in_the_order_of_flight(tmp_path, name):
    scene = load(tmp_path, name)
    cloud = scene.points.points
    seen = np.zeros(len(cloud))
    for view in scene.views:
        pixels, z = view.camera.project(cloud)
        seen += (z > 0) & (pixels >= 0).all(axis=1) & (pixels < [48, 36]).all(axis=1)
    assert np.mean(seen >= 5) > 0.85 and np.median(seen) >= 10
    steps = np.linalg.norm(np.diff([view.camera.center for view in scene.views], axis=0), axis=1)
    assert len(scene.views) == 40 and steps.max() < 2 * steps.min()  # lines lie as close as views; no way back
    assert scene.group == "" and scene.channels == 1


def test_hills_are_some_of_the_height(data_root):
    scene = small_dataset(data_root).load("hills")
    z = scene.points.points[:, 2]
    height = np.mean([view.camera.center[2] for view in scene.views])
    assert 0.10 < np.ptp(np.percentile(z, [1, 99])) / height < 0.20


def test_drift_and_shutter_follow_the_flight(tmp_path):
    scene = load(tmp_path, "field", walk_degC=4.0, shutter_views=10)
    truth = read_truth(scene.folder)
    shown = [np.mean(view.thermal[..., 0]) for view in scene.views]
    low, high = scene.temperature.min, scene.temperature.max
    added = low + (high - low) * np.array(shown) - [view.true_temperature.mean() for view in scene.views]
    assert truth.names == [view.name for view in scene.views]
    assert added == pytest.approx(truth.camera.offsets, abs=0.01)
    assert np.allclose(truth.camera.offsets[::10], truth.camera.offsets[0])
