import numpy as np

from tdgbench.scenes import Camera
from tdgbench.scenes.synthetic.render import look_at, shade, trace
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.scenes import small_dataset


def test_temperatures_are_in_the_image(data_root):
    """Gray values are the cast temperatures, up to noise and rounding."""
    scene = small_dataset(data_root).load("facade")
    world, view = WORLDS["facade"](0), scene.train[3]
    y, x = np.mgrid[0:36, 0:48] + 0.5
    points, depth, owner = trace(world, view.camera, np.stack([x.ravel(), y.ravel()], axis=-1))
    pixels, z = view.camera.project(points)
    assert np.allclose(pixels, np.stack([x.ravel(), y.ravel()], axis=-1)) and np.allclose(z, depth)
    assert np.allclose(depth.reshape(36, 48), view.true_depth, rtol=1e-5)
    _, degC = shade(world, points, owner)
    low, high = scene.temperature.min, scene.temperature.max
    assert np.median(np.abs(view.thermal[..., 0] * (high - low) + low - degC.reshape(36, 48))) < 0.2


def test_look_at():
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.array([1.0, 5.0, 3.0]))
    camera = Camera(np.eye(3), pose, 1, 1)
    assert np.allclose(camera.center, [1, 2, 3]) and np.allclose(pose[2, :3], [0, 1, 0])
    assert np.allclose(pose[:3, :3] @ [0, 0, 1], [0, -1, 0])  # up in the world is up in the image
