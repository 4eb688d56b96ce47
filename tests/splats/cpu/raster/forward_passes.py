"""Forward passes over random Gaussians, and bits of a block mask."""

import numpy as np

from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu.raster import blocks
from tdgbench.splats.cpu.raster.passes import forward
from tdgbench.splats.cpu.raster.source import GaussianSource, source_of_arrays
from tdgbench.splats.cpu.raster.types import Channels, ForwardPass, Settings, pack_camera, pack_limits


def settings_for(camera, width: int, height: int, colors: int, degree: int = -1, depth: bool = False) -> Settings:
    """Settings of a view: camera is viewmat (4, 4) and K (3, 3)."""
    packed = pack_camera(*camera, width, height, 0.2, 1e10, 0.3)
    channels = Channels(colors, degree, depth)
    return Settings(packed, width, height, channels, np.zeros(colors, np.float32), pack_limits(AS_3DGS))


def source_of(tensors) -> GaussianSource:
    return source_of_arrays([tensor.numpy() for tensor in tensors])


def rendered(parameters, cameras, width: int, height: int) -> ForwardPass:
    """Forward pass of `random_gaussians` without harmonics before the first camera of `turned_camera`."""
    settings = settings_for((cameras[0][0], cameras[1][0]), width, height, parameters[4].shape[1])
    return forward(source_of(parameters), settings)


def members(number: int) -> set[int]:
    """The set of a number's bits."""
    return {block for block in range(blocks.BLOCKS) if number >> block & 1}
