"""Mean absolute temperature error after the best offset of a view."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.mae_degc import differences
from tdgbench.scoring.scored_view import ScoredView


def mae_degC_without_offset(shown: ScoredView) -> float:
    """Return the mean absolute difference in °C from the median difference, the offset that makes it least."""
    values = differences(shown)
    return float(np.abs(values - np.median(values)).mean())


METRIC = ViewMetric(
    name="mae_degC_without_offset",
    label="temperature error without offset",
    meaning="mean absolute error of the temperatures after the offset of each test view that makes it least",
    order=82,
    unit="°C",
    fits_to_test_view="offset",
    needs="a temperature range, gray images",
    verified_to=1e-6,
    of_view=mae_degC_without_offset,
)
