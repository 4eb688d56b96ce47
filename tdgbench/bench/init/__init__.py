"""Initial points of the Gaussians: COLMAP's, of thermal images, or random."""

from tdgbench.bench.init.mvs_thermal import ThermalStereo
from tdgbench.bench.init.points import BoxAroundPoints, ColmapPoints, CubeAroundCameras, InitialPoints, ReleasedCube

__all__ = ["BoxAroundPoints", "ColmapPoints", "CubeAroundCameras", "InitialPoints", "ReleasedCube", "ThermalStereo"]
