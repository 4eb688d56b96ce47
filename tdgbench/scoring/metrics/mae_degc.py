"""Mean absolute temperature error."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView


def differences(shown: ScoredView) -> np.ndarray:
    """Return differences (N, 1) or (H, W, 1) of 8-bit pictures in °C, where gray values are linear in temperature."""
    if shown.scene is not None and shown.scene.raw_count_range is not None:
        raise NotApplicableError("raw counts have no °C")
    if shown.scene is None or shown.scene.temperature is None:
        raise NotApplicableError("the scene has no temperature range (temperature.json)")
    if shown.scene.channels != 1:
        raise NotApplicableError("the thermal images are pseudo-colour, which is not a linear temperature scale")
    image, target = shown.pair("thermal").pixels
    span = shown.scene.temperature.max - shown.scene.temperature.min
    return np.asarray((image - target).astype(np.float64) * span)


def mae_degC(shown: ScoredView) -> float:
    """Return the mean absolute difference in °C."""
    return float(np.abs(differences(shown)).mean())


METRIC = ViewMetric(
    name="mae_degC",
    label="temperature error",
    meaning="mean absolute error of the temperatures",
    order=80,
    unit="°C",
    needs="a temperature range, gray images",
    verified_to=1e-6,
    of_view=mae_degC,
)
