"""COLMAP models: cameras, poses, sparse points; distorted cameras become pinholes.

The files are read and checked here; pycolmap, whose reader allocates without end where a count is damaged, knows the
camera models and writes models.
"""

from tdgbench.scenes.colmap.log import quiet
from tdgbench.scenes.colmap.model import RegisteredImage, read_model, write_model
from tdgbench.scenes.colmap.pinhole import Undistortion

__all__ = ["RegisteredImage", "Undistortion", "quiet", "read_model", "write_model"]
