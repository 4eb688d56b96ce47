"""Ceiling of a scene: the PSNR that no model exceeds that shows the same surface from all sides.

It is the PSNR of a captured image against its expectation, given the scene and the view's camera as the scene's files
have it: what a model cannot know is the view's noise, its drift and its pose error. The mean squared error of a view
has four parts: noise of its pixels; the drift of its tones; what its displacement against the other views changes, the
mean of which is blurred; and what else points' values differ by between views in flat areas. Reflections of single
points, and distortions that no pose explains, are not among them; with these, a model stays farther below. No test
view is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.ceiling.displacement import Displacements, error_by_displacement, find_displacements
from tdgbench.ceiling.images import SmallImage
from tdgbench.ceiling.noise import noise_variance
from tdgbench.ceiling.registration import steepness_at
from tdgbench.ceiling.sightings import Sightings, find_sightings
from tdgbench.ceiling.spread import find_drift, flat_error, pixel_values
from tdgbench.scenes import Scene, View

HIGHEST = 45.0  # dB; a ceiling above it limits no training, and small errors of the estimate decide where it lies
FEWEST_SIGHTINGS = 500
SMALL_WIDTH = 160  # px, about, of the images in which views are registered


class Ceiling(NamedTuple):
    """What limits the PSNR of a scene's views.

    psnr: dB, at most; the mean over the training views; HIGHEST if it lies there or above. noise, drift, other:
    standard deviations, of image values in [0, 1], of the pixels' noise, of the views' tones, and of what else changes
    in flat areas between views. misregistration: of the views' displacements along each axis, px; 0 if uncertain.
    """

    psnr: float
    noise: float
    drift: float
    other: float
    misregistration: float

    def rounded(self) -> Ceiling:
        """The numbers as files keep them: dB and px to hundredths, image values to 1e-5.

        >>> Ceiling(24.4123, 0.0151234, 0.0, 0.0, 0.416).rounded()
        Ceiling(psnr=24.41, noise=0.01512, drift=0.0, other=0.0, misregistration=0.42)
        """
        noise, drift, other = (round(value, 5) for value in (self.noise, self.drift, self.other))
        return Ceiling(round(self.psnr, 2), noise, drift, other, round(self.misregistration, 2))

    def __str__(self) -> str:
        """`at most 24.4 dB of PSNR …`, with the reasons."""
        bound = f"at most {self.psnr:.1f} dB" if self.psnr < HIGHEST else f"more than {HIGHEST:.0f} dB"
        parts = [f"{name} {value:.4f}" for name, value in self._asdict().items() if name in ("noise", "drift", "other")]
        return f"{bound} of PSNR: {', '.join(parts)}, misregistration {self.misregistration:.2f} px"


class Unknown(NamedTuple):
    """Why a scene's ceiling is not known."""

    reason: str


def ceiling(scene: Scene) -> Ceiling | Unknown:
    """The ceiling of a scene, from its training views and sparse points. Masked pixels count for nothing."""
    if scene.points is None or not len(scene.points.points):
        return Unknown("the scene has no sparse points")
    views = [view for view in scene.train if view.valid is None or view.valid.any()]
    if len(views) < 2:
        return Unknown("the scene has fewer than two training views")
    side = max(1, round(views[0].camera.width / SMALL_WIDTH))
    images = [SmallImage.of(view, side) for view in views]
    sightings = find_sightings(views, scene.points.points)
    if len(sightings.point):
        steepness, keep = steepness_at(images, sightings.resized(side))
        keep = sightings.usable(keep & pixel_values(views, sightings).inside)
        sightings, steepness = sightings.kept(keep), steepness[keep]
    if len(sightings.point) < FEWEST_SIGHTINGS:
        return Unknown(f"only {len(sightings.point)} times a view sees a sparse point; {FEWEST_SIGHTINGS} are needed")
    return _ceiling(views, images, sightings, steepness)


def _ceiling(
    views: Sequence[View], images: Sequence[SmallImage], sightings: Sightings, steepness: np.ndarray
) -> Ceiling:
    """From sightings in the views, and the steepness (S,) of the images there."""
    side = views[0].camera.width // images[0].image.shape[1]
    values = pixel_values(views, sightings).values
    offsets = find_drift(images, sightings, values, steepness, tones=(1,)).at_sightings.mean(axis=1)
    displacements = find_displacements(images, sightings.resized(side), offsets, steepness).scaled(side)
    values, inside = pixel_values(views, sightings, displacements.by_view)
    keep = sightings.usable(inside)
    registered, values, steepness = sightings.kept(keep), values[keep], steepness[keep]
    drift = find_drift(images, registered, values, steepness)
    noise = np.array([_noise(view) for view in views])
    other = max(flat_error(registered, values - drift.at_sightings, steepness) - noise.mean(), 0.0)
    errors = noise + other + drift.errors + _by_displacement(views, sightings, displacements, noise)
    return Ceiling(
        psnr=min(float(np.mean(-10 * np.log10(np.maximum(errors, 10 ** (-HIGHEST / 5))))), HIGHEST),
        noise=float(noise.mean()) ** 0.5,
        drift=float(drift.errors.mean()) ** 0.5,
        other=other**0.5,
        misregistration=displacements.rms,
    )


def _noise(view: View) -> float:
    return float(np.mean([noise_variance(image, view.valid) for image in np.moveaxis(view.thermal, 2, 0)]))


def _by_displacement(
    views: Sequence[View], sightings: Sightings, displacements: Displacements, noise: np.ndarray
) -> np.ndarray:
    """Mean squared error (V,) that the displacements of the views cause."""
    errors, pixels, depths = np.zeros(len(views)), sightings.pixels(sightings.cameras), sightings.depths()
    if displacements.rms > 0:
        for index, (view, rows) in enumerate(zip(views, sightings.rows(), strict=True)):
            if rows.stop > rows.start:
                of_view = Displacements(displacements.by_view[rows], displacements.variance[rows])
                errors[index] = error_by_displacement(view, pixels[rows], depths[rows], of_view, noise[index])
    return errors
