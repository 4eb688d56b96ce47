"""PSNR of the RGB model."""

from tdgbench.scoring.metrics import psnr

METRIC = psnr.METRIC.of_rgb_model(order=50)
