"""Spread of points' values over the views that see them: drift of the views, flat noise, misregistration.

A view's value at a point is  I = m + t(m) + g · (J x + d) + n:  m is the point's own value, t the view's tone curve, g
the image's gradient, J x the error of the point's position, d the misregistration of the view and n noise. Tone curves
and positions are fitted; the squares of what remains are  c + |g|² σ²,  c in flat areas.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.ceiling.sightings import Samples, Sightings

BLURS = (4.0, 2.0, 1.0)  # px
TONES = 6  # steps of a tone curve
TONE_ROUNDS = 6
OUTLIER = 4.0  # standard deviations
MEDIAN_OF_SQUARE = 0.455  # of a standard normal number


class Residuals(NamedTuple):
    """What fits leave of sightings. squares: (S,) mean over channels, corrected for the fitted parameters.

    steepness: (S,) |g|², mean over channels. instrument: (S,) mean of `steepness` over the point's other views.
    """

    squares: np.ndarray
    steepness: np.ndarray
    instrument: np.ndarray


class Variances(NamedTuple):
    """flat: variance in flat areas. displacement: variance along each axis, px²."""

    flat: float
    displacement: float


class ToneCurves(NamedTuple):
    """Steps of the views' tone curves: edges (T - 1,) of brightness; curves (V, T, C). drift: (V,) mean squares."""

    edges: np.ndarray
    curves: np.ndarray
    drift: np.ndarray


def sums_by_point(values: np.ndarray, point: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, …) of values (S, …) by point."""
    columns = values.reshape(len(values), -1).T
    sums = np.stack([np.bincount(point, column, minlength=count) for column in columns], axis=1)
    return sums.reshape(count, *values.shape[1:])


def means_by_point(values: np.ndarray, point: np.ndarray, count: int) -> np.ndarray:
    """Means (count, …) of values (S, …) by point; 0 where a point has none."""
    number = np.maximum(np.bincount(point, minlength=count), 1)
    return sums_by_point(values, point, count) / number.reshape(-1, *[1] * (values.ndim - 1))


def only(sightings: Sightings, samples: Samples, keep: np.ndarray) -> tuple[Sightings, Samples]:
    """The sightings to keep (S,) and their samples, of points that enough views still see."""
    marked = replace(sightings, view=np.arange(len(keep))).kept(keep)
    rows = marked.view
    return replace(marked, view=sightings.view[rows]), Samples(*(array[rows] for array in samples))


def tone_curves(sightings: Sightings, samples: Samples) -> ToneCurves:
    """Fit the tone curves of all views; at every brightness their mean over views is 0."""
    point, view, count, views = sightings.point, sightings.view, len(sightings.points), len(sightings.cameras)
    channels = samples.values.shape[1]
    level = means_by_point(samples.values, point, count).mean(axis=1)[point]
    edges = np.quantile(level, np.linspace(0, 1, TONES + 1)[1:-1])
    cell = view * TONES + np.digitize(level, edges)
    steep = (samples.gradients**2).sum(axis=(1, 2))
    weight = 1 / (1 + steep / max(np.median(steep), 1e-12))
    total = np.bincount(cell, weight, minlength=views * TONES)
    curves = np.zeros((views * TONES, channels))
    for _ in range(TONE_ROUNDS):
        rest = samples.values - means_by_point(samples.values - curves[cell], point, count)[point]
        for channel in range(channels):
            off = rest[:, channel] - curves[cell, channel]
            limit = OUTLIER * max(np.sqrt(np.median(off**2) / MEDIAN_OF_SQUARE), 1e-6)
            near = np.clip(off, -limit, limit) + curves[cell, channel]
            curves[:, channel] = np.bincount(cell, weight * near, minlength=views * TONES) / np.maximum(total, 1e-9)
        table, share = curves.reshape(views, TONES, channels), total.reshape(views, TONES, 1)
        curves = (table - (share * table).sum(axis=0) / np.maximum(share.sum(axis=0), 1e-9)).reshape(curves.shape)
        curves[total == 0] = 0
    number = np.bincount(cell, minlength=views * TONES)
    error = np.bincount(cell, weight**2, minlength=views * TONES) / np.maximum(total, 1e-9) ** 2
    off = rest - curves[cell]
    noise = np.bincount(
        cell,
        weight * (np.minimum(off**2, np.median(off**2) / MEDIAN_OF_SQUARE * 9)).mean(axis=1),
        minlength=views * TONES,
    ) / np.maximum(total, 1e-9)
    square = ((curves**2).mean(axis=1) - error * noise).reshape(views, TONES)
    number = number.reshape(views, TONES)
    drift = (square * number).sum(axis=1) / np.maximum(number.sum(axis=1), 1)
    return ToneCurves(edges, curves.reshape(views, TONES, channels), np.maximum(drift, 0))


def without_drift(sightings: Sightings, samples: Samples, tones: ToneCurves) -> Samples:
    level = means_by_point(samples.values, sightings.point, len(sightings.points)).mean(axis=1)[sightings.point]
    return samples._replace(values=samples.values - tones.curves[sightings.view, np.digitize(level, tones.edges)])


def refine(sightings: Sightings, samples: Samples, reach: float) -> tuple[Residuals, np.ndarray]:
    """Residuals after the best move of each point, and these moves (P, 3) in world units.

    reach: how far points may lie from their place, px; 0: they stay.
    """
    point, count = sightings.point, len(sightings.points)
    number = np.maximum(np.bincount(point, minlength=count), 2)[point]
    rest = samples.values - means_by_point(samples.values, point, count)[point]
    leverage = np.zeros(rest.shape)
    shift = np.zeros((count, 3))
    if reach:
        slopes = np.matmul(samples.gradients, samples.moves)  # (S, C, 3) per world unit
        slopes = slopes - means_by_point(slopes, point, count)[point]
        noise = float(np.median(rest**2)) / MEDIAN_OF_SQUARE
        unit = np.sqrt((means_by_point(samples.moves, point, count) ** 2).sum(axis=(1, 2)) / 2 + 1e-30)  # px
        normal = sums_by_point(np.matmul(slopes.transpose(0, 2, 1), slopes), point, count)
        right = sums_by_point((slopes * rest[:, :, None]).sum(axis=1), point, count)
        inverse = np.linalg.inv(normal + np.eye(3) * ((noise + 1e-12) * (unit / reach) ** 2)[:, None, None])
        shift = -(inverse @ right[:, :, None])[:, :, 0]
        shift /= np.maximum(np.linalg.norm(shift, axis=1) * unit / reach, 1)[:, None]
        rest = rest + (slopes @ shift[point][:, :, None])[:, :, 0]
        leverage = (np.matmul(slopes, inverse[point]) * slopes).sum(axis=2)
    free = np.maximum(1 - 1 / number[:, None] - leverage, 0.1)
    steep = (samples.gradients**2).sum(axis=2).mean(axis=1)
    others = (means_by_point(steep, point, count)[point] * number - steep) / (number - 1)
    return Residuals((rest**2 / free).mean(axis=1), steep, others), shift


def variances(residuals: Residuals) -> tuple[Variances, np.ndarray]:
    """Fit c + |g|² σ² to the squares; which sightings (S,) are no outliers."""
    squares, steep, other = residuals
    keep = np.ones(len(squares), bool)
    low = other <= np.median(other)
    flat = max(float(np.median(squares[low])) / MEDIAN_OF_SQUARE, 1e-10)
    slope = max(float(np.median(squares[~low])) / MEDIAN_OF_SQUARE - flat, 0) / max(
        float(np.median(steep[~low])), 1e-12
    )
    for _ in range(12):
        keep = squares <= OUTLIER**2 * (flat + slope * np.maximum(steep, other))
        s, g, z = squares[keep], steep[keep], other[keep]
        w = 1 / (flat + slope * z) ** 2
        a, b, c, d, e, f = w.sum(), (w * g).sum(), (w * z).sum(), (w * z * g).sum(), (w * s).sum(), (w * z * s).sum()
        det = a * d - b * c
        flat, slope = ((e * d - b * f) / det, (a * f - c * e) / det) if det > 1e-6 * a * d else (e / a, 0.0)
        if slope < 0:
            flat, slope = e / a, 0.0
        elif flat < 1e-10:
            flat, slope = 1e-10, f / d
    return Variances(float(flat), float(slope)), keep
