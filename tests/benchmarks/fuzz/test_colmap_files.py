"""The strict readers accept what COLMAP's library accepts, and nothing that is cut or wrong."""

from __future__ import annotations

import math

import numpy as np
import pycolmap
import pytest

from benchmarks.fuzz.colmap_files import BINARY_FILES, read, read_binary, read_text, write_text
from benchmarks.fuzz.colmap_model import MalformedError
from benchmarks.fuzz.inputs import write_inputs


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    base = tmp_path_factory.mktemp("base")
    write_inputs(base)
    return base / "models"


@pytest.mark.parametrize("name", ["old", "new", "text"])
def test_pycolmap_reads_the_same_numbers(models, name):
    ours, theirs = read(models / name), pycolmap.Reconstruction(str(models / name))
    assert ours.problems() == []
    for image in ours.images:
        other = theirs.images[image.id]
        np.testing.assert_allclose(ours.pose(image)[:3], other.cam_from_world().matrix(), atol=1e-12)
        np.testing.assert_allclose(ours.cameras[0].matrix, other.camera.calibration_matrix())
        assert len(image.points) == len(other.points2D) and image.name == other.name
    for point in ours.points:
        np.testing.assert_array_equal(point.xyz, theirs.points3D[point.id].xyz)


@pytest.mark.parametrize("name", ["old", "new"])
def test_pycolmap_writes_what_the_reader_accepts(models, name, tmp_path):
    pycolmap.Reconstruction(str(models / name)).write_binary(str(tmp_path))
    assert read(tmp_path).problems() == []


@pytest.mark.parametrize("name", ["old", "new"])
def test_every_cut_is_seen(models, name, tmp_path):
    for path in (models / name / file for file in BINARY_FILES):
        for other in (models / name).iterdir():
            (tmp_path / other.name).write_bytes(other.read_bytes())
        data = path.read_bytes()
        for length in (0, 1, 7, 8, 9, len(data) // 2, len(data) - 1):
            (tmp_path / path.name).write_bytes(data[:length])
            with pytest.raises(MalformedError):
                read(tmp_path)
        (tmp_path / path.name).write_bytes(data + b"\0")
        with pytest.raises(MalformedError, match="too many"):
            read(tmp_path)


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -5.0, 1e300])
def test_focal_lengths(models, value):
    model = read_binary(models / "old")
    model.cameras[0].params[0] = value
    assert "camera 1" in model.problems()[0]


def test_text_survives_a_round(models, tmp_path):
    model = read_text(models / "text")
    write_text(tmp_path, model)
    assert read_text(tmp_path) == model
