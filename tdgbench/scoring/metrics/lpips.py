"""LPIPS; the network is in `scoring/lpips.py`."""

from __future__ import annotations

from tdgbench.scoring.metric import LPIPS_OPTIONS, ImageMetric

LPIPS = ImageMetric(
    name="lpips", label="LPIPS", meaning="learned perceptual distance", order=30, in_main_table=True,
    of_every_modality=True, needs="a backbone's weights", options=LPIPS_OPTIONS,
    of_images=lambda pair: pair.convention.lpips(pair.image, pair.target),
)  # fmt: skip
