"""LPIPS of the RGB model."""

from tdgbench.scoring.metrics import lpips

METRIC = lpips.METRIC.of_rgb_model(order=70)
