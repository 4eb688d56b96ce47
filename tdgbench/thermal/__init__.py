"""The thermal camera: estimate its response before training, and correct images for it."""

from tdgbench.thermal.camera import ThermalCamera, Unknown
from tdgbench.thermal.estimate import estimate_camera
from tdgbench.thermal.response import IDEAL, Corrected, ImageResponse, correct_values, corrected, read_response

__all__ = [
    "IDEAL", "Corrected", "ImageResponse", "ThermalCamera", "Unknown", "correct_values", "corrected", "estimate_camera",
    "read_response",
]  # fmt: skip
