"""Share of floaters."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric

FLOATER = 0.1  # rendered nearer than the true surface by more than this share of its depth


def floater_share(depth: np.ndarray, truth: np.ndarray) -> float:
    """Return the share of the pixels whose rendered depth lies clearly in front of the true surface.

    >>> floater_share(np.array([[0.8, 0.95]]), np.array([[1.0, 1.0]]))
    0.5
    """
    return float((depth < (1 - FLOATER) * truth).mean())


METRIC = ViewMetric(
    name="floaters",
    label="floaters",
    meaning="share of pixels more than 10 % nearer than the true surface",
    order=100,
    limits=(0.0, 1.0),
    needs="true depth",
    of_view=lambda shown: floater_share(*shown.depths()),
)
