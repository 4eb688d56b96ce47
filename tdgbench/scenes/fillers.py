"""Find pixels of temperature arrays that were never measured, but hold an ordinary number, as a warp leaves them.

A measured region is never exactly constant, but arrays made from 8-bit images or by simulation may be, and a scene may
really have 0 °C. So a value is a filler only if it fills a connected region that touches the border and has SMALLEST of
a view or more, and either the regions lie in the same place in SAME_PLACE of the views (the field of a thermal camera
does, objects do not), or the value is 0, the default of warping functions, and outside the range of all others.

Pixels of that value that are connected to the border are masked in every view; where the value is outside the range of
all others, so are those inside. A masked region grows by one pixel, since warping mixes the filler into its edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.measure import block_reduce

from tdgbench.scenes.temperature import PERCENTILES, TEMPERATURES, sampled

SMALLEST = 0.005  # of a view's pixels, that a filled region has
SAME_PLACE = 0.9  # of the views, in which a pixel is in a filled region
OVERLAP = 0.5  # of a filled region, that lies in the place that most views share
FEWEST_VIEWS = 3  # from which a shared place says something
MOST_CANDIDATES = 4  # values of a view's border that are tried; a warp has one or two
ROUNDING = 1e-3  # °C; dji-thermal-cli 1.4.0 writes float32 -273.15, which is above it, where nothing was measured
ZERO = 0.0  # °C, OpenCV's and scipy's default outside the source of a warp
NEIGHBOURS = np.ones((3, 3), bool)


@dataclass(frozen=True)
class Fillers:
    """Values that stand for pixels without a measurement, °C."""

    values: tuple[float, ...] = ()
    beyond: tuple[float, ...] = ()  # the values outside the range of all other temperatures

    def mask(self, degC: np.ndarray, block: int = 1) -> np.ndarray:
        """Return pixels (H, W) bool of temperatures (H, W) in °C that were not measured.

        block: side of the blocks in which a filler spoils its neighbours, px; 1: none.
        """
        invalid = impossible(degC)
        for value in self.values:
            same = degC == value
            filled = same if value in self.beyond else connected_to_border(same)
            invalid |= grown(filled, block)
        return invalid


def find_apart(views: Mapping[str, np.ndarray]) -> Fillers:
    """Find fillers in a scene's raw counts (H, W): values far from all others, which fill a border region.

    Far is more than all others span. A camera's counts lie far above 0, which warps fill with; in images that use all
    of the 16 bits, the lowest and the highest value are saturated pixels, next to others.
    """
    filled = {region.value for view in views.values() for region in _filled_regions(view)}
    if not filled:
        return Fillers()
    low, high = _range_without(views.values(), filled)
    return given_fillers(sorted(value for value in filled if max(low - value, value - high) > high - low))


def given_fillers(values: Iterable[float]) -> Fillers:
    """Return fillers that are all pixels of these values, wherever they are."""
    masked = tuple(map(float, values))
    return Fillers(masked, masked)


def grown(filled: np.ndarray, block: int = 1) -> np.ndarray:
    """Return filled pixels (H, W) bool, their neighbours, and all pixels of the blocks that they touch.

    >>> grown(np.array([[1, 0, 0, 0, 0, 0]], bool), block=4).astype(int)
    array([[1, 1, 1, 1, 0, 0]])
    """
    if not filled.any():
        return filled
    touched = block_reduce(ndimage.binary_dilation(filled, NEIGHBOURS), block, np.any)
    return touched.repeat(block, axis=0).repeat(block, axis=1)[: filled.shape[0], : filled.shape[1]]


def impossible(degC: np.ndarray) -> np.ndarray:
    """Return pixels (H, W) bool that are NaN, infinite, at or below absolute zero, or above what cameras measure."""
    with np.errstate(invalid="ignore"):
        return ~((degC > TEMPERATURES[0] + ROUNDING) & (degC <= TEMPERATURES[1]))


def connected_to_border(pixels: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool that other ones of them connect to the border.

    >>> connected_to_border(np.array([[1, 0, 0, 0], [1, 0, 1, 0], [0, 0, 0, 0]], bool)).astype(int)
    array([[1, 0, 0, 0],
           [1, 0, 0, 0],
           [0, 0, 0, 0]])
    """
    labels, _ = ndimage.label(pixels)
    return pixels & np.isin(labels, np.unique(_border(labels)))


def find_fillers(views: Mapping[str, np.ndarray], known: Collection[str] = ()) -> Fillers:
    """Find the fillers of a scene in the temperatures (H, W) in °C of all its views.

    known: views whose fillers are not finite; they show where the other views have theirs.
    """
    regions = [region for name, view in views.items() if name not in known for region in _filled_regions(view)]
    if not regions:
        return Fillers()
    masked = [_Region(np.nan, connected_to_border(impossible(views[name]))) for name in known]
    placed = {region.value for region in _in_the_same_place(regions, masked, len(views))}
    low, high = _range_without(views.values(), {region.value for region in regions})
    values = sorted({r.value for r in regions if r.value in placed or (r.value == ZERO and not low <= ZERO <= high)})
    return Fillers(tuple(values), tuple(value for value in values if not low <= value <= high))


class _Region(NamedTuple):
    """Pixels (H, W) bool of one value in one view that are connected to its border."""

    value: float
    pixels: np.ndarray


def _filled_regions(degC: np.ndarray) -> Iterator[_Region]:
    border = _border(degC)
    values, counts = np.unique(border[~impossible(border)], return_counts=True)
    for value in values[np.argsort(-counts, kind="stable")[:MOST_CANDIDATES]]:
        same = degC == value
        if same.mean() >= SMALLEST:
            pixels = connected_to_border(same)
            if pixels.mean() >= SMALLEST:
                yield _Region(float(value), pixels)


def _in_the_same_place(regions: list[_Region], masked: list[_Region], views: int) -> Iterator[_Region]:
    """Yield the regions that lie where most views have one. masked: regions of other views, which are known."""
    shape = Counter(region.pixels.shape for region in [*regions, *masked]).most_common(1)[0][0]
    count = sum((r.pixels for r in [*regions, *masked] if r.pixels.shape == shape), np.zeros(shape, np.int32))
    shared = count >= SAME_PLACE * views  # the regions of one view do not overlap
    if views < FEWEST_VIEWS or shared.mean() < SMALLEST:
        return
    for region in regions:
        if region.pixels.shape == shape and (region.pixels & shared).sum() >= OVERLAP * region.pixels.sum():
            yield region


def _range_without(views: Iterable[np.ndarray], values: set[float]) -> tuple[float, float]:
    """Return the range (°C), between PERCENTILES, of the temperatures of the pixels with other values."""
    views, filled = list(views), list(values)
    together = np.concatenate([sampled(v[~(impossible(v) | np.isin(v, filled))], len(views)).copy() for v in views])
    if not len(together):
        return -np.inf, np.inf
    low, high = np.percentile(together, PERCENTILES)
    return float(low), float(high)


def _border(image: np.ndarray) -> np.ndarray:
    """Return values (N,) of the outermost pixels of an image (H, W)."""
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
