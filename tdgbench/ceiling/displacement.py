"""Displacements of the views against one another, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tdgbench.ceiling.images import SmallImage, between, blurred, shows
from tdgbench.ceiling.registration import register
from tdgbench.ceiling.sightings import Sightings
from tdgbench.scenes import View

CERTAIN = 3.0  # standard errors; a smaller variance counts as 0
NEIGHBOURS = 3  # points whose displacements a pixel takes the mean of
PIXELS = 10_000  # of a view that are compared


class Displacements(NamedTuple):
    """Of the views from where the other views are, px of the sightings' cameras.

    by_view: (S, 2). variance: along each axis; 0 if it may be so by chance.
    """

    by_view: np.ndarray
    variance: float


def find_displacements(
    images: Sequence[SmallImage], sightings: Sightings, drift: np.ndarray, steepness: np.ndarray
) -> Displacements:
    """Register the views by two halves of the points, independently: the mean product has no part of their errors.

    images: of the views, of the size of the sightings' cameras. drift, steepness: (S,), as for `register`.
    """
    given, found, rows = sightings.pixels(sightings.cameras), [], sightings.rows()
    for half in sightings.halves():
        cameras = register(images, sightings.kept(half), drift[half], steepness[half])
        found.append(sightings.pixels(cameras) - given)
    product = np.array([(found[0] * found[1])[one].mean() if one.stop > one.start else 0.0 for one in rows])
    product /= (sightings.contrast() ** 2).sum(axis=1)
    variance, error = float(product.mean()), float(product.std() / len(product) ** 0.5)
    mean = (found[0] + found[1]) / 2
    if variance <= CERTAIN * error:
        return Displacements(np.zeros_like(mean), 0.0)
    return Displacements(mean * np.sqrt(variance / np.mean(mean**2)), variance)


def error_by_displacement(view: View, pixels: np.ndarray, displacements: Displacements, noise: float) -> float:
    """Mean squared error of a displaced view against the mean of others, which displacements blur.

    pixels: (N, 2) where points lie in the view. displacements: of this view there, and all views' variance, px of the
    view. noise: variance of the view's noise, whose part of the error is subtracted; it is that of white noise.
    """
    rng = np.random.default_rng(0)
    camera, variance = view.camera, displacements.variance
    at = np.stack([rng.integers(0, camera.width, PIXELS), rng.integers(0, camera.height, PIXELS)], axis=1)
    nearest = cKDTree(pixels).query(at + 0.5, k=min(NEIGHBOURS, len(pixels)))[1].reshape(PIXELS, -1)
    to = at + 0.5 + displacements.by_view[nearest].mean(axis=1)
    keep = shows(camera, view.valid, to)
    if view.valid is not None:
        keep &= view.valid[at[:, 1], at[:, 0]]
    if not keep.any():
        return 0.0
    at, to = at[keep], to[keep]
    errors = []
    for image in (*np.moveaxis(view.thermal, 2, 0), rng.normal(size=(camera.height, camera.width))):
        smooth = blurred(image, view.valid, variance**0.5)
        errors.append(np.mean((image[at[:, 1], at[:, 0]] - between(smooth, to, order=3)) ** 2))
    return max(float(np.mean(errors[:-1])) - noise * float(errors[-1]), 0.0)
