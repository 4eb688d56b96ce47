"""The rule for points: a training begins with as many of the measured points as its images have detail.

Structure from motion finds points where RGB images have texture. Thermal images are smoother: where one has no detail,
one Gaussian does. A Haar transform of each training image finds its detail. A square of 2ᵏ × 2ᵏ px has three
coefficients, differences of its quarters, to which white noise of standard deviation σ in every pixel adds σ:

    (a − b + c − d) / 2ᵏ,  (a + b − c − d) / 2ᵏ,  (a − b − c + d) / 2ᵏ,  of the sums a, b, c, d of the quarters

A square is divided into its quarters if one of these, or one of a square within it, exceeds `z` σ: the root mean square
over the channels. The others have no detail. Each of these keeps one point, that nearest to its middle, unless it
already holds a point that another image keeps. Views come in the order of the golden ratio, in which neighbours do not
follow one another.

Points that were found in thermal images lie where these have detail. So all are kept where most would be, and for RGB
models. Two limits: points behind a surface count as well as those on it, and fine texture all over an image counts as
noise. Points that no training view shows are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, NonNegativeFloat

from tdgbench.scenes import View
from tdgbench.scenes.images import nearest_valid
from tdgbench.training.images import THERMAL, Modality
from tdgbench.training.rule import Rule
from tdgbench.training.skips import NO_GAUSSIANS, Finished, Skip, summed

GOLDEN_SHARE = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class PointRule(Rule):
    """Begin with one measured point in each part of a training image that has no detail, instead of with all."""

    z: NonNegativeFloat  # standard deviations of noise that a coefficient of a square must exceed to divide it
    largest: Literal[8, 16, 32, 64, 128]  # px, side of the largest squares
    most: Annotated[float, Field(gt=0, le=1)]  # share of the points; where more have detail, all are kept

    def kept_points(self, points: np.ndarray, views: Sequence[View], images: Modality) -> np.ndarray | None:
        if images is not THERMAL:  # RGB images have detail where their points are
            return None
        noise, kept = images.typical_noise(views), np.zeros(len(points), bool)
        for number in np.argsort(np.arange(len(views)) * GOLDEN_SHARE % 1):
            view = views[number]
            image = nearest_valid(images.array(view), images.valid(view))
            squares = squares_without_detail(image, self.z * noise, self.largest)
            pixels, z = view.camera.project(points)
            shown = np.flatnonzero(view.camera.holds(pixels, z))
            x, y = pixels[shown].astype(int).T
            if (valid := images.valid(view)) is not None:
                x, y, shown = x[valid[y, x]], y[valid[y, x]], shown[valid[y, x]]
            square = squares.number[y, x]
            by_distance = np.hypot(*(pixels[shown] - squares.middle[square]).T).argsort(kind="stable")
            found, first = np.unique(square[by_distance], return_index=True)
            is_empty = ~np.isin(found, square[kept[shown]])
            kept[shown[by_distance[first[is_empty]]]] = True
        return kept if 0 < kept.sum() <= self.most * len(kept) else None

    def account(self, skip: Skip, training: Finished) -> None:
        left_out = summed(training.work, "points_left_out")
        all_kept = "no point was left out" if training.work else NO_GAUSSIANS
        reason = "one point each does where images have no detail" if left_out else all_kept
        skip.decide(left_out > 0, reason, f"{left_out} initial points")


class Squares(NamedTuple):
    """The squares without detail that make up an image of H × W px."""

    number: np.ndarray  # (H, W) int64, the square of a pixel
    middle: np.ndarray  # (S, 2) px, x and y by number; some lie beyond the image


def squares_without_detail(image: np.ndarray, least: float, largest: int) -> Squares:
    """Divide an image (H, W, C) into squares whose coefficients are at most `least`, with sides of up to `largest` px.

    >>> step = np.repeat([0.0, 1.0], [4, 12])[None, :, None] * np.ones((8, 1, 1))
    >>> squares_without_detail(step, 0.1, 8).middle.tolist()  # the edge is one of a square's quarters
    [[2.0, 2.0], [6.0, 2.0], [12.0, 4.0], [2.0, 6.0], [6.0, 6.0]]
    """
    height, width, _ = image.shape
    sums = np.pad(image.astype(np.float64), ((0, -height % largest), (0, -width % largest), (0, 0)), mode="edge")
    side: np.ndarray = np.ones(sums.shape[:2], np.int64)  # of each pixel's square, px
    divided = np.zeros(side.shape, bool)
    for size in 2 ** np.arange(1, largest.bit_length()):
        a, b, c, d = sums[::2, ::2], sums[::2, 1::2], sums[1::2, ::2], sums[1::2, 1::2]
        coefficients = np.stack([a - b + c - d, a + b - c - d, a - b - c + d]) / size
        within = divided[::2, ::2] | divided[::2, 1::2] | divided[1::2, ::2] | divided[1::2, 1::2]
        divided, sums = within | (np.sqrt((coefficients**2).mean(axis=-1)).max(axis=0) > least), a + b + c + d
        side[~divided.repeat(size, axis=0).repeat(size, axis=1)] = size
    y, x = np.indices(side.shape)
    corners, number = np.unique(y // side * side * side.shape[1] + x // side * side, return_inverse=True)
    middle = np.stack(np.divmod(corners, side.shape[1])[::-1], axis=1) + side.flat[corners][:, None] / 2
    return Squares(number.reshape(side.shape)[:height, :width], middle)
