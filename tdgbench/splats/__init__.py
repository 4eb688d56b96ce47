"""The splat core: Gaussians, rasterization of colour and depth, density control, optimiser, PLY.

It depends on no data set, method or configuration.
"""

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.render import rasterization

__all__ = ["Gaussians", "rasterization"]
