"""Synthetic RGB-thermal scenes with known depth and temperature, written from a seed at first use."""

from tdgbench.scenes.synthetic.capture import CaptureErrors, ThermalErrors, TrueRig
from tdgbench.scenes.synthetic.dataset import SyntheticDataset

__all__ = ["CaptureErrors", "SyntheticDataset", "ThermalErrors", "TrueRig"]
