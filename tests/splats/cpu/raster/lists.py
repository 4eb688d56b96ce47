"""The lists of a forward pass."""

import numpy as np

from tdgbench.splats.backends import cpu
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu.raster import passes
from tdgbench.splats.cpu.raster.limits import pack_limits


def lists(parameters, camera, width, height):
    means, quats, scales, opacities, colors = parameters
    settings = passes.Settings(
        camera=cpu.pack_camera(camera[0][0], camera[1][0], width, height, 0.2, 1e10, 0.3), width=width, height=height,
        degree=-1, depth_channel=False, background=np.zeros(1, np.float32), limits=pack_limits(AS_3DGS),
    )  # fmt: skip
    return passes.forward(cpu._arrays_of((means, scales, quats, opacities, colors[:, None])), settings)
