"""The true response of a synthetic thermal camera, to compare an estimate with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.thermal.camera import ViewResponses, normalized


class Truth(NamedTuple):
    """The true camera, normalized as an estimated one is: offsets and gains (V,), what is shared (H, W), in °C."""

    response: ViewResponses
    vignette: np.ndarray
    pattern: np.ndarray


def normalized_truth(truth: CameraTruth, views: Sequence[str], reference: float) -> Truth:
    """Return the true response in some views, with mean offset 0 and mean gain 1 at a reference temperature."""
    true, index = truth.camera, truth.index(list(views))
    gains = true.gains[index]
    offsets = true.offsets[index] + (gains - 1) * (reference - true.reference) + true.vignette.mean()
    response = normalized(ViewResponses(offsets + true.pattern.mean(), gains))
    return Truth(response, true.vignette - true.vignette.mean(), true.pattern - true.pattern.mean())
