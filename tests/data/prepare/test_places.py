import itertools

import numpy as np
import pycolmap
import pytest

from tdgbench.data.prepare.places import Taken, coordinates, doubted_by_height, nearest_pairs, read_taken, to_metres
from tdgbench.scenes import SceneError
from tests.helpers.exif import degrees, exif_gps, write_placed

XMP = b'<x drone-dji:GpsLatitude="-23.5" drone-dji:GpsLongtitude="+113.25" drone-dji:AbsoluteAltitude="+133.23"/>'


def test_places_in_files(tmp_path):
    def gps(*given):
        return read_taken(write_placed(tmp_path / "a.jpg", *given)).gps

    assert gps() is None and read_taken(tmp_path / "a.jpg") == Taken()
    assert gps(exif_gps(south=True), XMP) == pytest.approx((-23.06, -113.5, 133.25))
    assert gps(exif_gps(GPSAltitudeRef=b"\x01"))[2] == -133.25
    assert gps(None, XMP) == (-23.5, 113.25, 133.23) and read_taken(tmp_path / "a.jpg").height is None
    assert gps(exif_gps(GPSAltitude=None)) is None
    assert gps(exif_gps(GPSLatitude=degrees(0, 0, 0), GPSLongitude=degrees(0, 0, 0))) is None
    assert gps(None, XMP.replace(b"/>", b' drone-dji:RelativeAltitude="+30.00"/>')) == (-23.5, 113.25, 133.23)
    assert read_taken(tmp_path / "a.jpg").height == 30
    (tmp_path / "a.jpg").write_bytes(b"no image")
    assert read_taken(tmp_path / "a.jpg") == Taken()


def test_a_focal_length_that_contradicts_the_height_is_doubted():
    """Pictures from 15 m above the points that were taken from 30 m: the focal length is half of the true one."""
    down, level = np.diag([1.0, -1.0, -1.0, 1.0]), np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    down[2, 3] = 15
    points = np.random.default_rng(0).normal(0, 1, (50, 3)) * [10, 10, 0.5]
    (doubt,) = doubted_by_height([(down, height) for height in (30.0, 29.0, 31.0)], points, 380.0)
    assert "15 m above the points, by their files 30 m" in doubt and "nearer to 7" in doubt
    assert doubted_by_height([(down, height) for height in (14.0, 15.0, 17.0)], points, 380.0) == []
    assert doubted_by_height([(level, 30.0)] * 3, points - np.array([0, 0, 15]), 380.0) == []
    assert doubted_by_height([(down, 30.0)] * 3, points[:0], 380.0) == []


def test_coordinates_are_metres():
    found = coordinates({"a": (50.0, 8.0, 100.0), "c": (50.001, 8.0, 110.0)})
    assert list(found) == ["a", "c"] and found["c"] - found["a"] == pytest.approx([0, 111.2, 10], abs=0.1)
    with pytest.raises(SceneError, match=r"nearest: no file says where.*--matching sequential"):
        coordinates({})


def test_nearest_pairs():
    """Two flights, of which each is far from the other: neighbours are of one flight; names join them."""
    names = [f"{i:02}" for i in range(60)]
    positions = np.array([(i % 30, 1000 * (i // 30), 0) for i in range(60)], float)
    pairs = nearest_pairs(names, positions)
    assert pairs == sorted(set(pairs)) and all(a < b for a, b in pairs)
    assert [(a, b) for a, b in pairs if a < "30" <= b] == [("29", "30")]
    assert ("10", "15") in pairs and ("10", "17") not in pairs and 60 * 5 <= len(pairs) <= 60 * 10
    assert {(a, b) for a, b in nearest_pairs(names, np.zeros((60, 3)))} >= set(itertools.pairwise(names))


def synthetic(centres, seed=0):
    """A model whose cameras are at centres (N, 3), in a frame that is turned, moved and three times as large."""
    options = pycolmap.SyntheticDatasetOptions(num_rigs=1, num_frames_per_rig=len(centres), num_points3D=50)
    pycolmap.set_random_seed(seed)
    model = pycolmap.synthesize_dataset(options)
    positions = {}
    for frame_id, centre in zip(sorted(model.frames), centres, strict=True):
        frame = model.frame(frame_id)
        turn = frame.rig_from_world.rotation
        frame.rig_from_world = pycolmap.Rigid3d(turn, -(turn * np.asarray(centre, float)))
        positions[model.image(next(iter(frame.image_ids)).id).name] = np.asarray(centre, float)
    model.transform(pycolmap.Sim3d(3.0, pycolmap.Rotation3d([0.1, 0.2, 0.3, 0.9]), [4.0, 5.0, 6.0]))
    return model, positions


def test_a_model_is_put_in_metres():
    rng = np.random.default_rng(0)
    model, positions = synthetic(rng.uniform(0, 100, (8, 3)))
    measured = {name: place + rng.normal(0, 0.3, 3) for name, place in positions.items()}
    measured[next(iter(measured))] += 400  # an outlier
    note, is_in_metres = to_metres(model, measured, 0)
    assert is_in_metres and note.startswith("the model is in metres by GPS")
    centres = {image.name: image.projection_center() for image in model.images.values()}
    assert max(np.linalg.norm(centres[name] - place) for name, place in positions.items()) < 2


@pytest.mark.parametrize(
    ("centres", "what"),
    [(np.outer(np.arange(8), [10, 0, 0]), "spread by 0"), (np.random.default_rng(0).uniform(0, 1, (8, 3)), "at best")],
)
def test_positions_that_say_nothing_change_nothing(centres, what):
    """On a line, or of a scene that is as small as the errors of GPS."""
    model, positions = synthetic(centres)
    before = {image.name: image.projection_center() for image in model.images.values()}
    noise = np.random.default_rng(1)
    measured = {name: place + noise.normal(0, 0.3, 3) for name, place in positions.items()}
    note, is_in_metres = to_metres(model, measured, 0)
    assert note.startswith("the model has no metric scale") and what in note and not is_in_metres
    assert all(np.array_equal(image.projection_center(), before[image.name]) for image in model.images.values())
