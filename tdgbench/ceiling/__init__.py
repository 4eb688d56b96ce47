"""The PSNR that no model of a scene can exceed, from its training views and sparse points."""

from tdgbench.ceiling.cache import cached_ceiling
from tdgbench.ceiling.ceiling import HIGHEST, Ceiling, Unknown, ceiling

__all__ = ["HIGHEST", "Ceiling", "Unknown", "cached_ceiling", "ceiling"]
