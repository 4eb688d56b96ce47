"""SSIM of the RGB model."""

from tdgbench.scoring.metrics import ssim

METRIC = ssim.METRIC.of_rgb_model(order=60)
