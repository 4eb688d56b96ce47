"""Synthetic RGB-thermal scenes with known depth and temperature, written from a seed at first use."""

from tdgbench.scenes.synthetic.capture import CaptureErrors, TrueRig
from tdgbench.scenes.synthetic.dataset import SyntheticDataset
from tdgbench.scenes.synthetic.thermal_camera import ThermalErrors

__all__ = ["CaptureErrors", "SyntheticDataset", "ThermalErrors", "TrueRig"]
