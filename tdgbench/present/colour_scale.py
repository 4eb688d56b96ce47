"""The colour scale of a test view: decided by its ground truth, so the same for every method, and stated.

It does not end at the extremes: a few pixels of a cold sky would leave one colour for all the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10
from typing import NamedTuple

import numpy as np

ERROR_RANGE = 0.15  # end of the scale of errors, as a share of the colour scale
ENDS = (0.01, 0.99)  # quantiles of the ground truth
MOST_BELOW = 2  # how far the scale reaches below the median, by how far it reaches above
NARROWEST = 16 / 255  # image value: noise of a few levels of an even surface is not drawn as a contrast
FINEST = 0.1  # ends are multiples of 1, 0.1, 0.01, … that are at most this share of the scale


class ColourScale(NamedTuple):
    """What the colours of a test view span; as it is by default, the whole range, as for images in a palette.

    low, high, error: image values of range [0, 1]; errors are drawn from 0 to `error`. ends, error_end: the same as
    they are printed, with their unit; empty for a palette, whose colours have no order. colder, warmer: shares of the
    ground truth's pixels below and above, which have the colours of the ends.
    """

    low: float = 0.0
    high: float = 1.0
    error: float = ERROR_RANGE
    ends: tuple[str, str] | None = None
    error_end: str = f"{ERROR_RANGE:g} of the range of values"
    colder: float = 0.0
    warmer: float = 0.0

    @property
    def sentence(self) -> str:
        """The scales in words.

        >>> ColourScale(ends=("2 °C", "9 °C"), error_end="1.1 °C", colder=0.2).sentence
        'Colours span 2 °C to 9 °C (of the ground truth, 20.0 % is below, 0.0 % above), errors 0 to 1.1 °C.'
        """
        if self.ends is None:
            return f"Colours are those of the camera's palette, without a scale. Errors span 0 to {self.error_end}."
        beyond = f"of the ground truth, {self.colder:.1%} is below, {self.warmer:.1%} above".replace("%", " %")
        return f"Colours span {' to '.join(self.ends)} ({beyond}), errors 0 to {self.error_end}."


def colour_scale(
    truth: np.ndarray, valid: np.ndarray | None = None, degrees: Sequence[float] | None = None
) -> ColourScale:
    """Return the scale for a ground truth (H, W, 1 or 3) uint8. degrees: °C of its values 0 and 255.

    The scale goes from the 1st to the 99th percentile of the valid pixels, and reaches at most twice as far below the
    median as above: a sky of less than half of the picture does not take the scale. Its ends are round numbers.

    >>> facade = np.full((10, 10, 1), 230, np.uint8)
    >>> facade[:3], facade[6:] = 0, 250
    >>> colour_scale(facade, degrees=(-22, 7)).ends
    ('-0.4 °C', '6.5 °C')
    """
    values = truth[..., 0] if valid is None else truth[..., 0][valid]
    if truth.shape[2] != 1 or not values.size:
        return ColourScale()
    zero, one = degrees or (0.0, 1.0)
    first, median, last = (float(np.quantile(values, q)) / 255 for q in (ENDS[0], 0.5, ENDS[1]))
    low = max(first, median - MOST_BELOW * (last - median))
    widened = max(0.0, NARROWEST - (last - low)) / 2
    low, high = (zero + end * (one - zero) for end in (max(low - widened, 0.0), min(last + widened, 1.0)))
    unit = floor(log10(FINEST * max(high - low, 1e-9)))
    low, high = floor(low / 10**unit) * 10.0**unit, ceil(high / 10**unit) * 10.0**unit
    error, name = float(f"{ERROR_RANGE * (high - low):.2g}"), " °C" if degrees else ""
    of_values = [(end - zero) / max(one - zero, 1e-9) for end in (low, high)]
    return ColourScale(
        *of_values, error / max(one - zero, 1e-9),
        ends=(f"{low:.{max(0, -unit)}f}{name}", f"{high:.{max(0, -unit)}f}{name}"),
        error_end=f"{error:g}{name or ' of the range of values'}",
        colder=float((values < of_values[0] * 255).mean()), warmer=float((values > of_values[1] * 255).mean()),
    )  # fmt: skip
