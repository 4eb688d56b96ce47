"""Forward passes over random Gaussians."""

import numpy as np

from tdgbench.splats.cpu.raster.passes import forward
from tdgbench.splats.cpu.raster.types import (
    ForwardPass,
    GaussianSource,
    Settings,
    pack_camera,
    pack_limits,
    plain_channels,
    source_of_arrays,
)
from tdgbench.splats.view import AS_3DGS


def settings_for(camera, width: int, height: int, colors: int, degree: int = -1, depth: bool = False) -> Settings:
    """Settings of a view: camera is viewmat (4, 4) and K (3, 3)."""
    packed = pack_camera(*camera, width, height, 0.2, 1e10, 0.3)
    channels = plain_channels(colors, degree, depth)
    return Settings(packed, width, height, channels, np.zeros(colors, np.float32), pack_limits(AS_3DGS))


def source_of(tensors) -> GaussianSource:
    return source_of_arrays([tensor.numpy() for tensor in tensors])


def rendered(parameters, cameras, width: int, height: int) -> ForwardPass:
    """Forward pass of `random_gaussians` without harmonics before the first camera of `turned_camera`."""
    settings = settings_for((cameras[0][0], cameras[1][0]), width, height, parameters[4].shape[1])
    return forward(source_of(parameters), settings)
