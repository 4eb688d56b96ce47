import numpy as np

from tdgbench.splats.cpu.raster.types import pack_camera
from tests.helpers.gaussians import turned_camera


def test_packed_camera():
    (view,), (K,) = turned_camera(40, 30)
    camera = pack_camera(view, K, 40, 30, 0.2, 100.0, 0.3)
    assert np.allclose([camera.x_axis, camera.y_axis, camera.z_axis], view[:3, :3].numpy())
    assert np.allclose([camera.fx, camera.fy, camera.cx, camera.cy], [36, 36.8, 22, 12])
    assert np.allclose(view.numpy() @ [*camera.centre, 1], [0, 0, 0, 1], atol=1e-6)
    assert np.allclose([camera.near, camera.far, camera.eps2d, camera.width, camera.height], [0.2, 100, 0.3, 40, 30])
    exact = np.array(camera.centre, np.float64) + camera.centre_rest
    assert np.abs(view.double().numpy() @ [*exact, 1] - [0, 0, 0, 1]).max() < 1e-13


def test_every_number_is_single_precision():
    (view,), (K,) = turned_camera(40, 30)
    for field in pack_camera(view, K, 40, 30, 0.2, 100.0, 0.3):
        numbers = field if isinstance(field, tuple) else (field,)
        assert all(isinstance(number, np.float32) for number in numbers)
