"""Ceiling of a scene: the PSNR that no model exceeds that shows the same surface from all sides.

The mean squared error of a view has four parts: what the views' tone curves differ by (drift); what points' values
spread in flat areas besides (noise of the pixels, and whatever changes from view to view); and what displacements of
the views against one another change, averaged over the image's pixels (misregistration). No test view is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.ceiling import registration, spread
from tdgbench.ceiling.displacement import displaced, spread_by_displacement
from tdgbench.ceiling.noise import noise_variance
from tdgbench.ceiling.sightings import Sightings, blurred, find_sightings, sample, sample_pixels
from tdgbench.scenes import Scene, View

BLURS = (2.0, 2.0, 1.0)  # px, of the steps of registration
CLEARANCE = 5.0  # px to where the depth changes; nearer, a blurred pixel shows two surfaces
BLOCK = 20.0  # px, side of the blocks of points that belong to one half
FEWEST_SIGHTINGS, MOST_SIGHTINGS = 500, 40_000
RESOLVED = 0.35  # px; displacements below it cannot be told from the points' errors
STILL = 0.4  # share of an edge's error that a view without displacement has, since the best model is blurred
SMALLEST = 1e-10  # mean squared error


class Ceiling(NamedTuple):
    """What limits the PSNR of a scene's views.

    psnr: dB, at most; the mean over the training views. noise, drift, other: standard deviations, of image values in
    [0, 1], of the pixels' noise, of the views' tone curves, and of what else changes in flat areas between views.
    misregistration: of the views' displacements against one another along each axis, px; 0 if it is not resolved.
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
        parts = [f"{name} {value:.4f}" for name, value in self._asdict().items() if name in ("noise", "drift", "other")]
        return f"at most {self.psnr:.1f} dB of PSNR: {', '.join(parts)}, misregistration {self.misregistration:.2f} px"


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
    sightings = find_sightings(views, scene.points.points)
    sightings = sightings.kept(sightings.clearance >= CLEARANCE)
    stride = -(-len(sightings.point) // MOST_SIGHTINGS)
    sightings = sightings.kept(sightings.point % max(stride, 1) == 0)
    if len(sightings.point) < FEWEST_SIGHTINGS:
        return Unknown(f"only {len(sightings.point)} times a view sees a sparse point; {FEWEST_SIGHTINGS} are needed")
    displacement = _displacement(views, sightings)
    if displacement.any():
        sightings = replace(sightings, cameras=_registered(views, sightings))
    still = _still(views, sightings, float(displacement.mean()))
    errors = still.flat + still.steep + still.drift + _by_displacement(views, displacement)
    noise = float(np.mean([noise_variance(image, view.valid) for view in views for image in _channels(view)]))
    return Ceiling(
        psnr=float(np.mean(-10 * np.log10(np.maximum(errors, SMALLEST)))),
        noise=noise**0.5,
        drift=float(still.drift.mean()) ** 0.5,
        other=max(still.flat + still.steep - noise, 0.0) ** 0.5,
        misregistration=float(displacement.mean()) ** 0.5,
    )


def _displacement(views: Sequence[View], sightings: Sightings) -> np.ndarray:
    """Variance (V,) of the views' displacements along each axis, px²; 0 where it is not resolved."""
    halves = [_registered(views, sightings.kept(half)) for half in _halves(sightings)]
    common = registration.disagreement(sightings, halves)
    if common.mean() <= RESOLVED**2:
        return np.zeros(len(views))
    return np.maximum(common, 0) * (common.mean() / np.maximum(common, 0).mean())


def _halves(sightings: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Which sightings (S,) belong to the one and the other half of the points, in blocks like a chessboard's."""
    camera = sightings.cameras[0]
    z = np.median(np.abs(camera.project(sightings.points)[1]))
    blocks = np.floor(sightings.points / (BLOCK * z / camera.K[0, 0])).astype(int)
    odd = (blocks.sum(axis=1) % 2 == 1)[sightings.point]
    return ~odd, odd


def _registered(views: Sequence[View], sightings: Sightings):
    """The cameras of the views, registered step by step."""
    for blur in BLURS:
        samples = sample(views, sightings, blur)
        used, samples = spread.only(sightings, samples, samples.inside)
        samples = spread.without_drift(used, samples, spread.tone_curves(used, samples))
        residuals, _ = spread.refine(used, samples, 0.0)
        used, samples = spread.only(used, samples, spread.variances(residuals)[1])
        sightings = replace(sightings, cameras=registration.step(used, samples, blur))
    return sightings.cameras


class Still(NamedTuple):
    """Mean squared errors that are left when the views are registered.

    flat: in flat areas. steep: what grows with the image's gradients, over the images' pixels, besides what errors of
    the points explain. drift: (V,) of the views' tone curves.
    """

    flat: float
    steep: float
    drift: np.ndarray


def _still(views: Sequence[View], sightings: Sightings, displacement: float) -> Still:
    """Errors of registered views, in images averaged over displacements (px²)."""
    blur = BLURS[0]
    samples = sample(views, sightings, blur)
    pixels = sample_pixels(views, sightings, lambda image, valid: displaced(image, valid, displacement))
    used, both = spread.only(
        sightings, samples._replace(values=np.concatenate([samples.values, pixels], axis=1)), samples.inside
    )
    channels = pixels.shape[1]
    samples, sharp = both._replace(values=both.values[:, :channels]), both._replace(values=both.values[:, channels:])
    tones = spread.tone_curves(used, samples)
    samples, sharp = (spread.without_drift(used, one, tones) for one in (samples, sharp))
    as_given, _ = spread.variances(spread.refine(used, samples, 0.0)[0])
    refined, _ = spread.variances(spread.refine(used, samples, blur)[0])
    found, _ = spread.variances(spread.refine(used, sharp, 0.0)[0])
    steep = 0.0
    if refined.displacement > RESOLVED**2:
        share = min(1.0, refined.displacement / max(as_given.displacement, 1e-12))
        steep = found.displacement * share * float(np.mean([_steepness(view, blur) for view in views]))
    return Still(found.flat, steep, tones.drift)


def _steepness(view: View, blur: float) -> float:
    """Mean squared gradient of a blurred view over its valid pixels, per px², a mean over channels."""
    squares = [np.square(np.gradient(blurred(one, view.valid, blur))).sum(axis=0) for one in _channels(view)]
    return float(np.mean([one.mean() if view.valid is None else one[view.valid].mean() for one in squares]))


def _by_displacement(views: Sequence[View], displacement: np.ndarray) -> np.ndarray:
    """Mean squared error (V,) that the displacements of the views cause, over the images' valid pixels."""
    mean = float(displacement.mean())
    if mean == 0:
        return np.zeros(len(views))
    errors = []
    for view in views:
        maps = [spread_by_displacement(image, view.valid, mean) for image in _channels(view)]
        errors.append(np.mean([one.mean() if view.valid is None else one[view.valid].mean() for one in maps]))
    return np.array(errors) * (STILL + (1 - STILL) * displacement / mean)


def _channels(view: View) -> list[np.ndarray]:
    return [view.thermal[..., channel] for channel in range(view.thermal.shape[2])]
