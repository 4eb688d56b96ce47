"""Initial points of the Gaussians: COLMAP's, of thermal images, or random."""

from tdgbench.bench.init.colmap import ColmapPoints, InitialPoints
from tdgbench.bench.init.mvs_thermal import ThermalStereo
from tdgbench.bench.init.random import BoxAroundPoints, CubeAroundCameras, ReleasedCube

__all__ = ["BoxAroundPoints", "ColmapPoints", "CubeAroundCameras", "InitialPoints", "ReleasedCube", "ThermalStereo"]
