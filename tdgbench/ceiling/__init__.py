"""The PSNR that no model of a scene can exceed, from its training views and sparse points."""

from tdgbench.ceiling.ceiling import Ceiling, Unknown, ceiling

__all__ = ["Ceiling", "Unknown", "ceiling"]
