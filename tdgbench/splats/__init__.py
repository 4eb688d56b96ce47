"""The shared core: Gaussians, rasterization (colour and depth), density control, optimiser, PLY.

Knows no dataset, no method and no configuration.
"""

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.rasterization import rasterization

__all__ = ["Gaussians", "rasterization"]
