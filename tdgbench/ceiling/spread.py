"""What the values of points spread: by the views' drift, and in flat areas besides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.ceiling.images import SmallImage, between, blurred, shows
from tdgbench.ceiling.registration import MEDIAN_OF_SQUARE
from tdgbench.ceiling.sightings import Sightings
from tdgbench.scenes import View

TONES = (1, 3, 12)  # steps of brightness in which a view has one drift, each finer than the last
FEWEST = 20  # sightings that a step needs
ROUNDS = 3  # of the fit and of leaving out outliers
WEAKEST = 0.1  # share of the strongest singular value; weaker contrasts of views do not count
SUBPIXEL = 1.0  # px, σ of the blurred image that a pixel's value is moved to the point by
OUTLIER = 4.0  # standard deviations


class Drift(NamedTuple):
    """at_sightings: (S, C), image values. errors: (V,), mean squares over the views' pixels and channels."""

    at_sightings: np.ndarray
    errors: np.ndarray


def find_drift(
    images: Sequence[SmallImage],
    sightings: Sightings,
    values: np.ndarray,
    steepness: np.ndarray,
    tones: Sequence[int] = TONES,
) -> Drift:
    """Fit the views' drifts to values (S, C) of points that they share, from coarse to fine steps of brightness.

    Fine steps may have too few points that connect all views; then the coarse ones decide.
    """
    level = sightings.median(values.mean(axis=1))
    drift = np.zeros(values.shape)
    for count in tones:
        edges = np.quantile(level, np.linspace(0, 1, count + 1)[1:-1])
        steps, errors = np.digitize(level, edges), np.zeros(len(images))
        for step in np.unique(steps):
            here = steps == step
            part = sightings.kept(here)
            drift[here] += _fit(part, values[here] - drift[here], steepness[here])[part.view]
            total = np.bincount(part.view, (drift[here] ** 2).mean(axis=1), len(images))
            squares = total / np.maximum(np.bincount(part.view, minlength=len(images)), 1)
            errors += squares * [np.mean(np.digitize(image.values, edges) == step) for image in images]
    return Drift(drift, errors)


def _fit(sightings: Sightings, values: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """Drifts (V, C) that explain by how much views differ from the mean of a point's other views."""
    views = len(sightings.cameras)
    weight = 1 / (1 + (steepness / max(float(np.median(steepness)), 1e-9)) ** 2)
    contrast, number = sightings.contrast(), np.bincount(sightings.view, minlength=views)
    contrast[number < FEWEST] = np.eye(views)[number < FEWEST]
    drift = np.zeros((views, values.shape[1]))
    inverse = np.linalg.pinv(contrast, rcond=WEAKEST)
    for _ in range(ROUNDS):
        left = values - drift[sightings.view]
        rest = left - sightings.mean_of_others(left)
        limit = OUTLIER * np.sqrt(np.median(rest**2, axis=0) / MEDIAN_OF_SQUARE)
        rest = np.clip(rest, -limit, limit) * weight[:, None]
        total = np.stack([np.bincount(sightings.view, one, views) for one in rest.T], axis=1)
        mean = total / np.maximum(np.bincount(sightings.view, weight, views), 1e-12)[:, None]
        drift += inverse @ (mean * (number >= FEWEST)[:, None])
    return drift


def flat_error(sightings: Sightings, values: np.ndarray, steepness: np.ndarray) -> float:
    """Mean squared error of values (S, C) against the mean of a point's other views in flat areas.

    Intercept of the squares on steepness² in the flatter half of sightings; outliers do not count.
    """
    if len(values) < FEWEST:
        return 0.0
    rest = values - sightings.mean_of_others(values)
    share = 1 - 1 / sightings.sums(np.ones(len(rest)))
    flat = steepness <= np.median(steepness)
    squares, steep = ((rest**2).mean(axis=1) * share)[flat], steepness[flat] ** 2
    for _ in range(ROUNDS):
        keep = squares <= OUTLIER**2 * squares.mean()
        squares, steep = squares[keep], steep[keep]
    slope, intercept = np.polyfit(steep, squares, 1)
    return float(intercept if slope > 0 else squares.mean())


class Values(NamedTuple):
    """Of pixels at sightings: values (S, C); inside (S,) bool, whether they are in the image and valid."""

    values: np.ndarray
    inside: np.ndarray


def pixel_values(views: Sequence[View], sightings: Sightings, moves: np.ndarray | float = 0.0) -> Values:
    """Values of the pixels in which the points lie, displaced by `moves` (S, 2) px.

    They are moved from the pixel's centre to the point by a blurred image, which has little of the pixel's noise.
    """
    values, inside = np.zeros((len(sightings.point), views[0].thermal.shape[2])), np.zeros(len(sightings.point), bool)
    positions = sightings.pixels(sightings.cameras) + moves
    for view, rows in zip(views, sightings.rows(), strict=True):
        inside[rows] = shows(view.camera, view.valid, positions[rows])
        limits = (view.camera.width - 1, view.camera.height - 1)
        column, row = np.clip(np.floor(positions[rows]), 0, limits).astype(int).T
        for channel, image in enumerate(np.moveaxis(view.thermal, 2, 0)):
            smooth = blurred(image, view.valid, SUBPIXEL)
            values[rows, channel] = image[row, column] + between(smooth, positions[rows]) - smooth[row, column]
    return Values(values, inside)
