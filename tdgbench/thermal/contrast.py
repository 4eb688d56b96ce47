"""Contrast of thermal images: what is done to all of a scene's images before training.

TDg names temporally consistent normalisation and CLAHE as future work. `percentile`, `clahe` and `bbhe` look at each
image alone, `sequence` and `cdf` at the training views together. All but `sequence` lose the temperatures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tdgbench.scenes import Scene, SceneError, TemperatureRange, View
from tdgbench.scenes.images import in_pseudo_colour, nearest_valid
from tdgbench.scenes.options import Contrast
from tdgbench.text import first_few

TAILS = (1.0, 99.0)  # percentiles that become 0 and 1
CLIP_LIMIT = 0.01  # of CLAHE, scikit-image's default: share of a tile's pixels in one bin
BINS = 256  # of the histograms
QUANTILES = np.linspace(0, 1, BINS + 1)
SMALLEST = 1e-6  # image values; a smaller range is not stretched
Curve = Callable[[np.ndarray, np.ndarray | None], np.ndarray]  # image (H, W) and its mask, to an image (H, W)


def with_contrast(scene: Scene, contrast: Contrast) -> Scene:
    """Return the scene with another contrast in all its thermal images, of training and test views alike.

    Masked pixels have no part in it. The scene has a fingerprint of its own, and temperatures, also true ones, only
    where the contrast keeps them. Raises SceneError for images in pseudo-colour.
    """
    if contrast == "none":
        return scene
    colored = in_pseudo_colour(scene.views)
    if colored:
        raise SceneError(
            f"{scene.name}: thermal images are pseudo-coloured ({first_few(colored)}); channels are no contrast; "
            "give gray images, or contrast.training=none"
        )
    temperature = None
    if contrast == "sequence":
        low, high = _common_tails(scene.train)
        curve: Curve = _stretch(low, high)
        if scene.temperature is not None:
            zero, span = scene.temperature.min, scene.temperature.max - scene.temperature.min
            temperature = TemperatureRange(zero + span * low, zero + span * high)
    elif contrast == "cdf":
        curve = _to_quantiles(midway([_values(view) for view in scene.train]))
    else:
        curve = {"percentile": _percentile, "clahe": _clahe, "bbhe": _bbhe}[contrast]

    def changed(view: View) -> View:
        image = _changed(view, curve)
        truth = view.load_true_temperature if contrast == "sequence" else None
        return view.with_thermal(image, load_true_temperature=truth)

    return replace(
        scene, train=[changed(view) for view in scene.train], test=[changed(view) for view in scene.test],
        temperature=temperature, raw_count_range=None,
        fingerprint=scene.fingerprint_with(b"contrast", contrast.encode()),
    )  # fmt: skip


def _changed(view: View, curve: Curve) -> np.ndarray:
    """Return the image (H, W, C) float32 in [0, 1]; 0 at masked pixels, unchanged without a valid pixel."""
    if view.valid is not None and not view.valid.any():
        return view.thermal
    image = curve(view.thermal.mean(axis=2, dtype=np.float64), view.valid).clip(0, 1)
    if view.valid is not None:
        image = np.where(view.valid, image, 0.0)
    return np.repeat(image.astype(np.float32)[..., None], view.thermal.shape[2], axis=2)


def _values(view: View) -> np.ndarray:
    """Return valid values (N,)."""
    return _at(view.thermal.mean(axis=2, dtype=np.float64), view.valid)


def _at(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    return image.ravel() if valid is None else image[valid]


def _common_tails(views: Sequence[View]) -> tuple[float, float]:
    values = np.concatenate([_values(view) for view in views])
    low, high = np.percentile(values, TAILS)
    return float(low), max(float(high), float(low) + SMALLEST)


def _stretch(low: float, high: float) -> Curve:
    return lambda image, _: (image - low) / (high - low)


def _percentile(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    low, high = np.percentile(_at(image, valid), TAILS)
    return (image - low) / max(high - low, SMALLEST)


def _clahe(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Apply contrast-limited adaptive histogram equalisation (Zuiderveld 1994), by scikit-image.

    In the place of masked pixels stand the nearest valid ones.
    """
    from skimage.exposure import equalize_adapthist  # here, as it takes a third of a second to import

    image = nearest_valid(image, valid)
    low, high = float(image.min()), float(image.max())
    if high - low < SMALLEST:
        return image
    equalized: np.ndarray = equalize_adapthist((image - low) / (high - low), clip_limit=CLIP_LIMIT)
    return equalized


def _bbhe(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Apply brightness-preserving bi-histogram equalisation (Kim 1997): values below and above the mean apart.

    Each part is spread over the range between the ends of the image's values and their mean.
    """
    values = _at(image, valid)
    low, mean, high = float(values.min()), float(values.mean()), float(values.max())
    below, above = values[values <= mean], values[values > mean]
    dark = _equalized(image, below, low, mean)
    return np.where(image <= mean, dark, _equalized(image, above, mean, high)) if above.size else dark


def _equalized(image: np.ndarray, values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Replace image values by the share of the values below them, from `low` to `high`."""
    counts, edges = np.histogram(values, BINS, (low, max(high, low + SMALLEST)))
    shares = np.concatenate([[0], np.cumsum(counts)]) / max(counts.sum(), 1)
    return low + (high - low) * np.interp(image, edges, shares)


def midway(values: Sequence[np.ndarray]) -> np.ndarray:
    """Return quantiles (BINS + 1,) that lie midway between those of several images' values (Delon 2004): their mean.

    >>> midway([np.array([0.0, 0.2]), np.array([0.4, 0.6])])[[0, -1]].tolist()
    [0.2, 0.4]
    """
    return np.mean([np.quantile(image, QUANTILES) for image in values if image.size], axis=0)


def _to_quantiles(target: np.ndarray) -> Curve:
    """Return a curve that gives each image the quantiles `target`: histograms become alike over time."""

    def curve(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
        own, place = np.unique(np.quantile(_at(image, valid), QUANTILES), return_inverse=True)
        wanted = np.bincount(place, target) / np.bincount(place)  # a mean over equal quantiles, as of a flat area
        return np.interp(image, own, wanted)

    return curve
