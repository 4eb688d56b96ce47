"""Procedural RGB-thermal scenes with known depth and temperature, made from a seed at first use."""

from tdgbench.scenes.synthetic.dataset import SyntheticDataset

__all__ = ["SyntheticDataset"]
