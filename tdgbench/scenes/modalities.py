"""Modalities: the kinds of images that views have and methods render. All have `thermal`; its names are plain."""

from __future__ import annotations

import numpy as np

from tdgbench.scenes.scene import View

THERMAL = "thermal"
LABELS = {THERMAL: "thermal", "rgb": "RGB"}  # in print, by modality
OTHERS = tuple(modality for modality in LABELS if modality != THERMAL)


def image_of(view: View, modality: str) -> np.ndarray | None:
    """Return the image (H, W, C) of a view, float32 in [0, 1]; None if it has none of this modality."""
    if modality == THERMAL:
        return view.thermal
    return None if view.load_rgb is None else view.rgb
