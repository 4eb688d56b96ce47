"""Work that a scene may not need: each skip decides from the scene's data, gives its reason, and can be switched off.

A skip is one file of this package and one line of `conf/skip/default.yaml`.
"""

from tdgbench.training.skips.registry import Skips
from tdgbench.training.skips.skip import Skip

__all__ = ["Skip", "Skips"]
