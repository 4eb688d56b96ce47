"""Share of pixels that the training views hardly determine."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.scored_view import at_valid
from tdgbench.splats.determinacy import ONE_VIEW


def is_barely_seen(determinacy: np.ndarray) -> np.ndarray:
    """Return which pixels are determined less than by one training view from the same place.

    >>> is_barely_seen(np.array([0.1, 0.9])).tolist()
    [True, False]
    """
    return ~(determinacy >= ONE_VIEW)  # NaN: nothing is known


BARELY_SEEN = ViewMetric(
    name="barely_seen", label="barely seen",
    meaning="share of pixels that training views determine less than one view from the same place would", order=120,
    has_better_side=False, limits=(0.0, 1.0), needs="Gaussians",
    of_view=lambda shown: float(is_barely_seen(at_valid(shown.valid, shown.rendered.known_determinacy)).mean()),
)  # fmt: skip
