"""Times are the benchmark's business; here, that both readers give the same and that a slow one is told."""

import sys

import numpy as np
import pytest

from benchmarks import models
from tdgbench.scenes.colmap import read_model


def test_both_readers_give_the_same(tmp_path):
    for folder in models.write_models(tmp_path, points=200, images=4):
        poses, points, colors = models.read_with_pycolmap(folder)
        read = read_model(folder)
        assert np.array_equal(read.points.points, points)
        assert np.array_equal(np.round(read.points.colors * 255), colors)
        assert {image.camera.world_to_camera[:3].tobytes() for image in read.images.values()} == {
            np.ascontiguousarray(pose).tobytes() for pose in poses
        }


@pytest.mark.parametrize(("seconds", "status"), [(1.0, 0), (1.3, 1)])
def test_a_slow_reader_ends_with_status_1(tmp_path, monkeypatch, capsys, seconds, status):
    monkeypatch.setattr(models, "interleave", lambda *_: {"pycolmap": [1.0], "checked": [seconds]})
    monkeypatch.setattr(sys, "argv", ["models", str(tmp_path / "model")])
    if status:
        with pytest.raises(SystemExit, match="1"):
            models.main()
    else:
        models.main()
    assert f"ratio {seconds:.2f}" in capsys.readouterr().out
