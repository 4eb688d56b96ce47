import json
from collections import Counter

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.data.prepare import prepare as module
from tdgbench.data.prepare.prepare import PrepareOptions, prepare
from tdgbench.data.prepare.sfm import Structure
from tdgbench.scenes import FolderDataset, PointCloud, ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.truth import read_truth
from tests.helpers.layouts import celsius


@pytest.fixture(scope="module")
def drifting(tmp_path_factory):
    """A scene whose camera drifts, and the camera files of it: float TIFF beside RGB images."""
    folder = tmp_path_factory.mktemp("drifting")
    errors = CaptureErrors(camera=ThermalErrors(walk_degC=3.0, vignette_degC=2.0))
    scene = SyntheticDataset(str(folder), ReadOptions(), 96, 72, views=12, points=2500, errors=errors).load("turntable")
    files = folder / "files"
    for sub in ("rgb", "thermal"):
        (files / sub).mkdir(parents=True)
    for view in scene.views:
        Image.fromarray(np.uint8(view.rgb * 255)).save(files / "rgb" / f"{view.name}.png")
        Image.fromarray(celsius(view, scene)).save(files / "thermal" / f"{view.name}.tiff")
    return scene, files


@pytest.fixture
def known_structure(drifting, monkeypatch):
    """Stands in for COLMAP: the scene's own cameras and points. Returns a list; what it holds replaces the points."""
    scene, _ = drifting
    points: list[PointCloud] = []

    def reconstruct(images, names, work, options):
        K = scene.views[0].camera.K
        camera = pycolmap.Camera(model="PINHOLE", width=96, height=72, params=[K[0, 0], K[1, 1], 48, 36])
        poses = {name: view.camera.world_to_camera for name, view in zip(names, scene.views, strict=True)}
        cloud = points[0] if points else scene.points
        return Structure(camera, poses, cloud, 0.5, [12], Counter(), Counter())

    monkeypatch.setattr(module, "reconstruct", reconstruct)
    return points


def written(folder, name):
    return np.asarray(Image.open(folder / "thermal" / f"{name}.tiff")).astype(np.float64)


def test_training_views_are_corrected_and_test_views_are_not(drifting, known_structure, tmp_path):
    scene, files = drifting
    plain = prepare(files, tmp_path / "plain", PrepareOptions())
    report = prepare(files, tmp_path / "out", PrepareOptions(camera="estimated"))
    truth = read_truth(scene.folder)
    true = truth.camera
    left = []
    for view in scene.views:
        change = written(tmp_path / "out", view.name) - written(tmp_path / "plain", view.name)
        if view.name in {one.name for one in scene.test}:
            assert not change.any()
            continue
        index = truth.index([view.name])[0]
        left.append(change + true.offsets[index] + true.vignette)
    assert np.std(left) < 0.1 < 1 < np.std(true.offsets)
    stored = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["thermal_camera"]
    assert set(stored["views"]) == {view.name for view in scene.train} and stored["split"] == "eighty_twenty"
    assert "thermal camera: offsets" in report.text() and "test views are as they were" in report.text()
    assert plain.thermal_camera is None and "thermal camera" not in plain.text()
    again = FolderDataset(str(tmp_path / "out"), ReadOptions()).load(None)
    assert (again.temperature.min, again.temperature.max) == report.temperature != plain.temperature


def test_without_points_nothing_is_corrected_and_the_report_says_why(drifting, known_structure, tmp_path):
    _, files = drifting
    known_structure.append(PointCloud(np.zeros((0, 3)), np.zeros((0, 3), np.float32)))
    report = prepare(files, tmp_path / "out", PrepareOptions(camera="estimated"))
    plain = prepare(files, tmp_path / "plain", PrepareOptions())
    assert "not corrected" in report.text() and "no sparse points" in report.text()
    for path in (tmp_path / "plain" / "thermal").iterdir():
        assert path.read_bytes() == (tmp_path / "out" / "thermal" / path.name).read_bytes()
    assert report.temperature == plain.temperature
