"""Displacements of the views against one another, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from tdgbench.ceiling.images import SmallImage, between, blurred, shows
from tdgbench.ceiling.registration import register
from tdgbench.ceiling.sightings import Sightings
from tdgbench.scenes import View

CERTAIN = 3.0  # standard errors; a smaller variance counts as 0
NEIGHBOURS = 6  # points by a pixel, of which the one in front says how the pixel is displaced
LEVELS = 3  # of blur, between which errors are interpolated
PIXELS = 10_000  # of a view that are compared


class Displacements(NamedTuple):
    """Of the views from where the other views are, px of the sightings' cameras.

    by_view: (S, 2). variance: (S,) along each axis, by the point's depth; 0 if it may be so by chance.
    """

    by_view: np.ndarray
    variance: np.ndarray

    @property
    def rms(self) -> float:
        """Along each axis, px."""
        return float(self.variance.mean()) ** 0.5

    def scaled(self, factor: float) -> Displacements:
        """In px of images that are `factor` times as large."""
        return Displacements(factor * self.by_view, factor**2 * self.variance)


def find_displacements(
    images: Sequence[SmallImage], sightings: Sightings, drift: np.ndarray, steepness: np.ndarray
) -> Displacements:
    """Register the views by two halves of the points, independently: the mean product has no part of their errors.

    Turned cameras displace all points alike, displaced ones by 1 / depth: the variance is a + b / depth².

    images: of the views, of the size of the sightings' cameras. drift, steepness: (S,), as for `register`.
    """
    given, found, rows = sightings.pixels(sightings.cameras), [], sightings.rows()
    for half in sightings.halves():
        cameras = register(images, sightings.kept(half), drift[half], steepness[half])
        found.append(sightings.pixels(cameras) - given)
    product = (found[0] * found[1]).mean(axis=1) / (sightings.contrast() ** 2).sum(axis=1)[sightings.view]
    by_view = np.array([product[one].mean() if one.stop > one.start else 0.0 for one in rows])
    mean = (found[0] + found[1]) / 2
    if by_view.mean() <= CERTAIN * by_view.std() / len(by_view) ** 0.5:
        return Displacements(np.zeros_like(mean), np.zeros(len(mean)))
    nearness = 1 / sightings.depths() ** 2
    factors = np.stack([np.ones(len(nearness)), nearness / nearness.mean()], axis=1)
    variance = factors @ nnls(factors.T @ factors, factors.T @ product)[0]
    return Displacements(mean * np.sqrt(variance.mean() / np.mean(mean**2)), variance)


def error_by_displacement(
    view: View, pixels: np.ndarray, depths: np.ndarray, displacements: Displacements, noise: float
) -> float:
    """Mean squared error of a displaced view against the mean of others, which displacements blur.

    pixels: (N, 2) where points lie in the view. depths: (N,) of them. displacements: at them, px of the view. noise:
    variance of the view's noise, whose part of the error is subtracted; it is that of white noise.
    """
    rng = np.random.default_rng(0)
    camera = view.camera
    at = np.stack([rng.integers(0, camera.width, PIXELS), rng.integers(0, camera.height, PIXELS)], axis=1)
    nearest = cKDTree(pixels).query(at + 0.5, k=min(NEIGHBOURS, len(pixels)))[1].reshape(PIXELS, -1)
    point = nearest[np.arange(PIXELS), depths[nearest].argmin(axis=1)]
    to = at + 0.5 + displacements.by_view[point]
    keep = shows(camera, view.valid, to)
    if view.valid is not None:
        keep &= view.valid[at[:, 1], at[:, 0]]
    if not keep.any():
        return 0.0
    at, to, variance = at[keep], to[keep], displacements.variance[point[keep]]
    errors = []
    for image in (*np.moveaxis(view.thermal, 2, 0), rng.normal(size=(camera.height, camera.width))):
        others = _blurred_at(image, view.valid, to, variance)
        errors.append(np.mean((image[at[:, 1], at[:, 0]] - others) ** 2))
    return max(float(np.mean(errors[:-1])) - noise * float(errors[-1]), 0.0)


def _blurred_at(image: np.ndarray, valid: np.ndarray | None, pixels: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Values (N,) at positions (N, 2) of an image (H, W) blurred by Gaussians of `variance` (N,), px²."""
    levels = np.unique(np.linspace(variance.min(), variance.max(), LEVELS))
    known = np.stack([between(blurred(image, valid, one**0.5), pixels, order=3) for one in levels])
    place = np.interp(variance, levels, np.arange(len(levels)))
    low = np.minimum(place.astype(int), max(len(levels) - 2, 0))
    high, rows = np.minimum(low + 1, len(levels) - 1), np.arange(len(pixels))
    return np.asarray(known[low, rows] + (place - low) * (known[high, rows] - known[low, rows]))
