"""Work that a scene may not need: each skip decides from the scene's data, says why, and can be switched off."""

from tdgbench.training.skips.skip import Skip, Skips

__all__ = ["Skip", "Skips"]
