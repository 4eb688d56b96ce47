"""The thermal camera: estimate its response before training, and correct images for it."""

from tdgbench.thermal.camera import ThermalCamera, Unknown
from tdgbench.thermal.correct import correct_values, corrected
from tdgbench.thermal.estimate import estimate_camera

__all__ = ["ThermalCamera", "Unknown", "correct_values", "corrected", "estimate_camera"]
