import numpy as np
import torch

from tdgbench.scenes import Camera
from tdgbench.splats.view import EPS2D, FAR_PLANE, NEAR_PLANE, Pinhole


def test_a_camera_keeps_its_precision_until_it_is_converted():
    camera = Camera(np.eye(3) / 3, np.eye(4) / 3, 40, 30)
    pinhole = Pinhole.of(camera)
    assert pinhole.viewmat.dtype == torch.float64 and pinhole.K[0, 0].item() == 1 / 3
    assert pinhole[2:] == (40, 30, NEAR_PLANE, FAR_PLANE, EPS2D)
    single = pinhole.to(torch.zeros(1))
    assert single.K.dtype == single.viewmat.dtype == torch.float32 and single[2:] == pinhole[2:]
