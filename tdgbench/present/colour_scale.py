"""The colour scale of a test view: decided by its ground truth, so the same for every method, and stated.

It does not end at the extremes: a few pixels of a cold sky would leave one colour for all the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10
from typing import NamedTuple

import numpy as np

ERROR_RANGE = 0.15  # least end of the scale of errors, as a share of the colour scale
ENDS = (0.01, 0.99)  # quantiles of the ground truth
SHOWN_ERRORS = 0.95  # quantile of the errors that is no lighter than the end of their scale
MOST_BELOW = 2  # how far the scale reaches below the median, by how far it reaches above
NARROWEST = 16 / 255  # image value: noise of a few levels of an even surface is not drawn as a contrast
FINEST = 0.15  # ends are multiples of 1, 0.1, 0.01, … that are at most this share of the scale
OF_RANGE = " of the range of values"


class ColourScale(NamedTuple):
    """What the colours of a test view span; as it is by default, the whole range, as for images in a palette.

    low, high, error: image values of range [0, 1]; errors are drawn from 0 to `error`. ends, error_end: the same as
    they are printed; ends are None for a palette, whose colours have no order. unit: of these, ` °C` if it is known.
    colder, warmer: shares of the ground truth's pixels below and above, which have the colours of the ends.
    degrees: °C of image values 0 and 1; None if they are unknown.
    """

    low: float = 0.0
    high: float = 1.0
    error: float = ERROR_RANGE
    ends: tuple[str, str] | None = None
    error_end: str = f"{ERROR_RANGE:g}{OF_RANGE}"
    unit: str = OF_RANGE
    colder: float = 0.0
    warmer: float = 0.0
    degrees: tuple[float, float] | None = None

    def of_range(self, degrees: Sequence[float] | None) -> ColourScale:
        """Return the scale of the same °C for pictures whose image values 0 and 1 are other `degrees`.

        Raises ValueError where one of the ranges is unknown.

        >>> scale = ColourScale(0.0, 0.5, 0.2, ends=("10", "15"), degrees=(10, 20)).of_range((0, 40))
        >>> scale.low, scale.high, scale.error
        (0.25, 0.375, 0.05)
        """
        other = None if degrees is None else (degrees[0], degrees[1])
        if other == self.degrees or self.ends is None:
            return self
        low, high = in_range(self.low, self.high, self.degrees, other)
        error = self.error * width_of(self.degrees) / width_of(other)
        return self._replace(low=low, high=high, error=error, degrees=other)

    @property
    def span(self) -> str:
        """Both ends in words; empty for a palette."""
        return "" if self.ends is None else f"{' to '.join(self.ends)}{self.unit}"

    @property
    def sentence(self) -> str:
        """The scales in words.

        >>> ColourScale(ends=("2", "9"), error_end="1.1 °C", unit=" °C", colder=0.2).sentence  # doctest: +ELLIPSIS
        'Colours span 2 to 9 °C (20.0 % of the ground truth is below, 0.0 % above). Errors from 0 to 1.1 °C; ...'
        """
        errors = f"Errors from 0 to {self.error_end}; larger ones have the last colour."
        if self.ends is None:
            return f"Colours are those of the camera's palette, without a scale. {errors}"
        beyond = f"{100 * self.colder:.1f} % of the ground truth is below, {100 * self.warmer:.1f} % above"
        return f"Colours span {self.span} ({beyond}). {errors}"


def colour_scale(
    truth: np.ndarray,
    valid: np.ndarray | None = None,
    degrees: Sequence[float] | None = None,
    errors: np.ndarray | None = None,
) -> ColourScale:
    """Return the scale for a ground truth (H, W, 1 or 3) uint8. degrees: °C of its values 0 and 255.

    The scale goes from the 1st to the 99th percentile of the valid pixels, and reaches at most twice as far below the
    median as above: a sky of less than half of the picture does not take the scale. Its ends are round numbers. That of
    errors ends at ERROR_RANGE of it, or where 95 % of the `errors` (image values, those of all methods) are below.

    >>> facade = np.full((10, 10, 1), 230, np.uint8)
    >>> facade[:3], facade[6:] = 0, 250
    >>> colour_scale(facade, degrees=(-22, 7)).span
    '-1 to 7 °C'
    """
    values = truth[..., 0] if valid is None else truth[..., 0][valid]
    known = np.empty(0) if errors is None else errors[np.isfinite(errors)]
    largest = float(np.quantile(known, SHOWN_ERRORS)) if known.size else 0.0
    if truth.shape[2] != 1:
        error = _rounded(max(ERROR_RANGE, largest))
        return ColourScale(error=error, error_end=f"{error:g}{OF_RANGE}")
    zero, width = degrees[0] if degrees else 0.0, width_of(degrees)
    values = values if values.size else np.array([0, 255])  # all is masked: the whole range
    unit = " °C" if degrees else OF_RANGE
    first, median, last = (float(np.quantile(values, q)) / 255 for q in (ENDS[0], 0.5, ENDS[1]))
    low = max(first, median - MOST_BELOW * (last - median))
    if last - low < NARROWEST:
        low = min(max((low + last - NARROWEST) / 2, 0.0), 1 - NARROWEST)
        last = low + NARROWEST
    low, high = (zero + end * width for end in (low, last))
    power = floor(log10(FINEST * max(high - low, 1e-9)))
    low, high = floor(low / 10**power) * 10.0**power, ceil(high / 10**power) * 10.0**power
    error = _rounded(max(ERROR_RANGE * (high - low), largest * width))
    first, last = ((end - zero) / width for end in (low, high))
    return ColourScale(
        first, last, error / width, unit=unit, error_end=f"{error:g}{unit}",
        ends=(f"{low:.{max(0, -power)}f}", f"{high:.{max(0, -power)}f}"),
        colder=float((values < first * 255).mean()), warmer=float((values > last * 255).mean()),
        degrees=None if degrees is None else (degrees[0], degrees[1]),
    )  # fmt: skip


def in_range(
    low: float, high: float, degrees: Sequence[float] | None, other: Sequence[float] | None
) -> tuple[float, float]:
    """Return the image values of the same °C in another range. degrees, other: °C of image values 0 and 1.

    Raises ValueError where one of the ranges is unknown, and the other one is not.
    """
    if degrees == other:
        return low, high
    if degrees is None or other is None:
        raise ValueError("the °C of its values are unknown, or those of the scale: no colours hold for both")
    start, end = (((degrees[0] - other[0]) + width_of(degrees) * value) / width_of(other) for value in (low, high))
    return start, end


def width_of(degrees: Sequence[float] | None) -> float:
    """Return what image values from 0 to 1 span: °C, or 1 where these are unknown."""
    return max(degrees[1] - degrees[0], 1e-9) if degrees else 1.0


def _rounded(value: float) -> float:
    return float(f"{value:.2g}")
