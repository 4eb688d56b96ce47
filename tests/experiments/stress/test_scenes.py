from dataclasses import replace

import numpy as np
import pytest

from tdgbench.experiments.stress.scenes import shifted, with_cameras_on_a_line, with_points


def test_points(small_gray_scene):
    scene = with_points(small_gray_scene, np.zeros((3, 3)))
    assert scene.points.points.shape == (3, 3) and (scene.points.colors == 0.5).all()


def test_cameras_on_a_line(small_gray_scene):
    scene = with_cameras_on_a_line(small_gray_scene, lambda i: 0.2 * i)
    steps = np.diff([view.camera.center for view in scene.train], axis=0)
    assert np.allclose(np.linalg.norm(steps, axis=1), 0.2) and np.allclose(steps, steps[0])


def test_a_shifted_scene_projects_to_the_same_pixels(small_gray_scene):
    scene = shifted(small_gray_scene, 100.0)
    for before, after in zip(small_gray_scene.train, scene.train, strict=True):
        pixels, z = before.camera.project(small_gray_scene.points.points)
        moved_pixels, moved_z = after.camera.project(scene.points.points)
        assert np.allclose(pixels, moved_pixels, atol=1e-6) and np.allclose(z, moved_z)
    with pytest.raises(ValueError, match="no points to shift"):
        shifted(replace(small_gray_scene, points=None), 1.0)
