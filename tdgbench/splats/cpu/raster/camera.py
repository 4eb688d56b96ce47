"""The camera, as the kernels read it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Triple = tuple[np.float32, np.float32, np.float32]


class Camera(NamedTuple):
    """Pinhole camera with OpenCV axes (x right, y down, z forward); every number is float32.

    Pixel centres lie at whole numbers + 1/2.
    """

    x_axis: Triple  # rows of the world-to-camera rotation
    y_axis: Triple
    z_axis: Triple
    fx: np.float32  # px
    fy: np.float32
    cx: np.float32
    cy: np.float32
    centre: Triple  # world
    centre_rest: Triple  # what float32 leaves of the centre
    near: np.float32
    far: np.float32
    eps2d: np.float32  # px², added to the diagonal of the image covariance
    width: np.float32  # px
    height: np.float32


def pack_camera(viewmat, K, width: int, height: int, near_plane: float, far_plane: float, eps2d: float) -> Camera:
    """Camera of viewmat (4, 4), world to camera, and K (3, 3), px; arrays or tensors on the CPU."""
    view = np.asarray(viewmat, np.float64)
    K = np.asarray(K, np.float64)
    axes = (_triple(row) for row in view[:3, :3])
    exact = np.linalg.solve(view[:3, :3], -view[:3, 3])
    centre = _triple(exact)
    intrinsics = map(np.float32, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    planes_and_size = map(np.float32, (near_plane, far_plane, eps2d, width, height))
    return Camera(*axes, *intrinsics, centre, _triple(exact - np.array(centre)), *planes_and_size)


def _triple(values: np.ndarray) -> Triple:
    x, y, z = values.astype(np.float32)
    return x, y, z
