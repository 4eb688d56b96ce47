"""Initial points of the Gaussians: COLMAP's, triangulated from thermal images, or random."""

from tdgbench.bench.init.colmap import ColmapPoints, InitialPoints
from tdgbench.bench.init.random import BoxAroundPoints, CubeAroundCameras, ReleasedCube
from tdgbench.bench.init.sfm_thermal import SfmThermal

__all__ = ["BoxAroundPoints", "ColmapPoints", "CubeAroundCameras", "InitialPoints", "ReleasedCube", "SfmThermal"]
