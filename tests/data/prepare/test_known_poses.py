"""Scenes of poses that another program found."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tdgbench.data.poses.metashape import TABLE
from tdgbench.data.prepare import known_poses
from tdgbench.data.prepare import prepare as module
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions
from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tdgbench.scenes.colmap import read_model
from tests.helpers.relief import BOARD, FOCAL, HEIGHT, WALL, WIDTH, places, write_relief

CENTRES = places(3, 2)
OPTIONS = PrepareOptions(sfm=SfmOptions("thermal", threads=1))


def opensfm(path, names, points=()):
    """Write poses of cameras at CENTRES that look along z."""
    lens = {"projection_type": "perspective", "width": WIDTH, "height": HEIGHT, "focal": FOCAL / WIDTH}
    shots = {
        name: {"rotation": [0, 0, 0], "translation": (-centre).tolist(), "camera": "a"}
        for name, centre in zip(names, CENTRES, strict=False)
    }
    cloud = {str(i): {"coordinates": list(point), "color": [0, 255, 51]} for i, point in enumerate(points)}
    path.write_text(json.dumps([{"cameras": {"a": lens}, "shots": shots, "points": cloud}]))
    return replace(OPTIONS, poses=path)


def table(path, names, origin):
    """Write Metashape's table of the same poses, by another origin."""
    turn = " ".join(map(str, np.diag([1.0, -1, -1]).ravel())).split()
    rows = ["\t".join([name, *map(repr, (centre + origin).tolist()), "0", "0", "0", *turn])
            for name, centre in zip(names, CENTRES, strict=False)]  # fmt: skip
    path.write_text("\n".join([TABLE, *rows]))
    return replace(OPTIONS, poses=path)


def content(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*") if "report" not in path.name}


def test_points_are_triangulated_and_a_stopped_run_goes_on(tmp_path, monkeypatch):
    files = write_relief(tmp_path / "camera", CENTRES)
    options = opensfm(tmp_path / "a.json", [path.name for path in files[:-1]] + ["other.tiff"])
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
    assert (report.count("written"), report.files[-1].status) == (5, "not registered")
    assert report.files[-1].reason == f"{tmp_path / 'a.json'} has no pose of it" and report.error_px < 0.3
    assert "known poses: " in report.text() and "1 of its 6 poses are of no image" in report.text()
    model = read_model(tmp_path / "scene" / "sparse" / "0")
    depths = model.points.points[:, 2]
    assert len(depths) > 200 and np.median(np.minimum(abs(depths - WALL), abs(depths - BOARD))) < 0.02
    for path, centre in zip(files[:-1], CENTRES, strict=False):
        camera = model.images[path.stem].camera
        assert camera.K[0, 0] == FOCAL and camera.center == pytest.approx(centre)

    def stop(*given):
        raise SceneError("stopped")

    with monkeypatch.context() as stopped, pytest.raises(SceneError, match="stopped"):
        stopped.setattr(module, "_write_views", stop)
        prepare_scene(tmp_path / "camera", tmp_path / "again", options)
    monkeypatch.setattr(known_poses, "_triangulate", stop)
    prepare_scene(tmp_path / "camera", tmp_path / "again", options)
    assert content(tmp_path / "again") == content(tmp_path / "scene")


def test_a_lens_is_refined_at_the_poses(tmp_path):
    """Of shipped points, too, which are triangulated then."""
    files = write_relief(tmp_path / "camera", CENTRES)
    options = opensfm(tmp_path / "a.json", [path.name for path in files], [(0, 0, 6)])
    options = replace(options, sfm=SfmOptions("thermal", 1.1 * FOCAL, threads=1, refine=True))
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
    model = read_model(tmp_path / "scene" / "sparse" / "0")
    assert model.images["00"].camera.K[0, 0] == pytest.approx(FOCAL, rel=0.01) and report.points > 200


def test_shipped_points_need_no_matches(tmp_path, monkeypatch):
    """Of RGB images, too, whose files are named otherwise than the view."""
    for path in write_relief(tmp_path / "camera", CENTRES[:3]):
        Image.fromarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8)).save(path.with_name(f"{path.stem}_V.png"))
        path.rename(path.with_name(f"{path.stem}_T.tiff"))
    monkeypatch.setattr(known_poses, "matched", None)
    points = [(0, 0, 6), (0.5, 0, 4.5)]
    options = opensfm(tmp_path / "a.json", ["00_V.png", "01_V.png", "02_V.png"], points)
    options = replace(options, sfm=SfmOptions(), pairs=("*_T.tiff", "*_V.png"))
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
    found = read_model(tmp_path / "scene" / "sparse" / "0").points
    assert np.allclose(found.points, points) and np.allclose(found.colors, (0, 1, 0.2))
    assert report.is_complete and "known poses: 2 points, OPENCV" in report.text()


def test_origin_and_lens_of_a_map(tmp_path):
    """Reading the scene moves its origin. Without features there are no points."""
    (tmp_path / "camera").mkdir()
    for index in range(3):
        slope = np.tile(np.linspace(20, 21 + index / 100, WIDTH, dtype=np.float32), (HEIGHT, 1))
        Image.fromarray(slope).save(tmp_path / "camera" / f"{index}.tiff")
    origin = np.array([2.6e6, 1.2e6, 400])
    options = table(tmp_path / "a.txt", ["0.tif", "1.tif", "2.tif"], origin)
    options = replace(options, sfm=replace(options.sfm, focal=FOCAL))
    assert "there are no points" in prepare_scene(tmp_path / "camera", tmp_path / "scene", options).text()
    model = read_model(tmp_path / "scene" / "sparse" / "0")
    centres = np.array([model.images[str(i)].camera.center for i in range(3)])
    assert model.points is None and centres == pytest.approx(CENTRES[:3] + origin, abs=1e-6)
    scene = FolderDataset(str(tmp_path / "scene"), ReadOptions()).load(None)
    assert "between the cameras" in scene.assumed["origin"] and np.abs(scene.views[0].camera.center).max() < 1


def test_errors_say_what_to_do(tmp_path):
    write_relief(tmp_path / "camera", CENTRES[:3])
    options = opensfm(tmp_path / "a.json", ["x.png", "y.png"])
    with pytest.raises(SceneError, match=r"poses of 0 of 3 images \(x, y … against 00, 01 …\); 3 are needed. Rename"):
        prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
