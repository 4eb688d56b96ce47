"""PSNR of the pixels that the training views determine."""

from __future__ import annotations

from dataclasses import replace

from tdgbench.scoring.metrics import psnr_barely_seen

METRIC = replace(
    psnr_barely_seen.METRIC,
    name="psnr_well_seen",
    label="PSNR, well seen",
    meaning="PSNR over all pixels of the test views that are not barely seen",
    order=122,
    needs="Gaussians, well-seen pixels",
    of_view=lambda shown: psnr_barely_seen.psnr_where(shown, barely=False),
)
