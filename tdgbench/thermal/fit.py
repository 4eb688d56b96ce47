"""Robust least squares for the response of a thermal camera, with the temperatures of the points as further unknowns.

Minimises Σ ρ((value − T_p − (gain_v − 1) (T_p − reference) − offset_v − vignette(x, y)) / σ) over temperatures,
offsets, gains and coefficients by Gauss-Newton with weights; temperatures are eliminated (Schur complement). A
temperature that is an unknown of its own, and no mean of values, leaves the gains unbiased by noise. σ depends on the
slope of the image, as errors of position do; ρ is Huber's, then Tukey's (Holland and Welsch 1977), which ignores
outliers. A prior holds what the values tell little about near an ideal camera.

Errors of neighbouring values are not independent: registration and reflections are wrong for whole surfaces. So a patch
of a view, one of PATCHES × PATCHES, has an error of its own, whose variance limits the total weight of its values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_matrix, diags

from tdgbench.thermal.camera import ViewResponses
from tdgbench.thermal.expected_errors import NORMAL
from tdgbench.thermal.observations import PointSamples

ROUNDS, HUBER_ROUNDS = 24, 5
SETTLED = 0.02  # change of the parameters in standard deviations of the residuals, at which rounds end
HUBER, TUKEY = 1.345, 4.685  # 95 % efficient where errors are normal (Holland and Welsch 1977)
SLOPE_BINS = 12
FEWEST_IN_PATCH = 4  # values, of a patch whose mean tells of the patches' own errors


class Terms(NamedTuple):
    """Which terms of the response are estimated; the others are those of an ideal camera."""

    vignette: bool = False
    offsets: bool = False
    gains: bool = False

    def free(self, data: PointSamples) -> np.ndarray:
        """Return which of the parameters (2 V + K,) are estimated."""
        return np.repeat([self.offsets, self.gains, self.vignette], [data.views, data.views, data.terms.shape[1]])


@dataclass(frozen=True)
class Fit:
    """Responses of V views, coefficients (K,), temperatures (P,), reference; residuals (S,) and their weights (S,).

    before: robust standard deviation of values about the mean of their point; after: of the residuals. known: returns
    what the values tell of each direction of the F estimated parameters, (F,) inverse variances in those of the prior.
    """

    response: ViewResponses
    vignette: np.ndarray
    temperatures: np.ndarray
    reference: float
    residuals: np.ndarray
    weights: np.ndarray
    before: float
    after: float
    known: Callable[[], np.ndarray]

    @property
    def undetermined(self) -> int:
        """Directions of the estimated parameters that the prior determines more than the values do.

        The mean offset, which no value tells anything about, is one of them, and so is the mean gain.
        """
        return int(np.count_nonzero(self.known() < 1))


def fit(data: PointSamples, terms: Terms, precision: np.ndarray) -> Fit:
    """Estimate the response. precision: (2 V + K, 2 V + K) of the prior of offsets, gains and coefficients."""
    reference = float(np.median(data.value))
    free = terms.free(data)
    counts = np.bincount(data.point, None, data.points)
    theta, temperatures = data.ideal, np.bincount(data.point, data.value, data.points) / np.maximum(counts, 1)
    residuals = data.value - temperatures[data.point]
    before = deviation(residuals)
    for round_ in range(ROUNDS):
        sigma = _sigma(residuals, data.slope)
        weights = _weights(residuals / sigma, robust=round_ >= HUBER_ROUNDS) / sigma**2
        weights = _shared(weights, residuals, data.patch)
        system = System(data, theta, temperatures, reference, weights)
        step = system.solve(residuals, precision @ (data.ideal - theta), precision, free)
        temperatures = temperatures + system.temperature_step(residuals, step)
        theta = theta + step
        residuals = data.value - predict(data, theta, temperatures, reference)
        if round_ > HUBER_ROUNDS and np.abs(step).max() < SETTLED * deviation(residuals):
            break
    response = ViewResponses(theta[: data.views], theta[data.views : 2 * data.views])
    return Fit(
        response=response,
        vignette=theta[2 * data.views :],
        temperatures=temperatures,
        reference=reference,
        residuals=residuals,
        weights=weights,
        before=before,
        after=deviation(residuals),
        known=lambda: system.directions(precision, free)[0],
    )


def predict(data: PointSamples, theta: np.ndarray, temperatures: np.ndarray, reference: float) -> np.ndarray:
    """Return values (S,) that the model gives. theta: offsets, gains and coefficients, (2 V + K,)."""
    offsets, gains, vignette = np.split(theta, [data.views, 2 * data.views])
    degC = temperatures[data.point]
    return degC + (gains[data.view] - 1) * (degC - reference) + offsets[data.view] + data.terms @ vignette


class System:
    """Normal equations of one round, without the temperatures, which are eliminated."""

    def __init__(
        self, data: PointSamples, theta: np.ndarray, temperatures: np.ndarray, reference: float, weights: np.ndarray
    ) -> None:
        count, rows = len(data.value), np.arange(len(data.value))
        gains = theta[data.views : 2 * data.views][data.view]
        entries = np.stack([np.ones(count), temperatures[data.point] - reference], axis=1)
        columns = np.stack([data.view, data.views + data.view], axis=1)
        start = np.arange(0, 2 * count + 1, 2)
        self.by_view = csr_matrix((entries.ravel(), columns.ravel(), start), shape=(count, 2 * data.views))
        self.terms, self.weights = data.terms, weights
        self.by_point = csr_matrix((gains * weights, (data.point, rows)), shape=(data.points, count))
        self.curvature = np.maximum(np.bincount(data.point, weights * gains**2, data.points), 1e-12)
        self.from_views, self.from_terms = self.by_point @ self.by_view, self.by_point @ self.terms

    @cached_property
    def matrix(self) -> np.ndarray:
        """Normal matrix (2 V + K, 2 V + K)."""
        views = self.by_view.shape[1]
        matrix = np.empty((views + self.terms.shape[1],) * 2)
        heavy, inverse = diags(self.weights), diags(1 / self.curvature)
        matrix[:views, :views] = (self.by_view.T @ heavy @ self.by_view).toarray()
        matrix[:views, :views] -= (self.from_views.T @ inverse @ self.from_views).toarray()
        matrix[:views, views:] = self.by_view.T @ (self.weights[:, None] * self.terms)
        matrix[:views, views:] -= self.from_views.T @ (self.from_terms / self.curvature[:, None])
        matrix[views:, :views] = matrix[:views, views:].T
        matrix[views:, views:] = self.terms.T @ (self.weights[:, None] * self.terms)
        matrix[views:, views:] -= self.from_terms.T @ (self.from_terms / self.curvature[:, None])
        return matrix

    def solve(self, residuals: np.ndarray, pull: np.ndarray, precision: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Return the step of offsets, gains and coefficients, 0 where not `free`. pull, precision: of the prior."""
        weighted, pulled = self.weights * residuals, (self.by_point @ residuals) / self.curvature
        right = np.r_[
            self.by_view.T @ weighted - self.from_views.T @ pulled, self.terms.T @ weighted - self.from_terms.T @ pulled
        ]
        step = np.zeros(len(free))
        matrix = (self.matrix + precision)[np.ix_(free, free)]
        step[free] = np.linalg.solve(matrix, (right + pull)[free])
        return step

    def directions(self, precision: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what the values tell of each direction of the F `free` parameters (F,), and the directions (F, F).

        In units of the prior: the eigenvalues of the normal matrix by its precision, and vectors that it makes
        orthonormal.
        """
        block = np.ix_(free, free)
        known, axes = eigh(self.matrix[block], precision[block]) if free.any() else (np.zeros(0), np.zeros((0, 0)))
        return np.maximum(known, 0.0), axes

    def temperature_step(self, residuals: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the step (P,) of the temperatures, given that of the other parameters."""
        views = self.by_view.shape[1]
        moved = self.from_views @ step[:views] + self.from_terms @ step[views:]
        return (self.by_point @ residuals - moved) / self.curvature


def deviation(residuals: np.ndarray) -> float:
    """Return the robust standard deviation."""
    return NORMAL * float(np.median(np.abs(residuals)))


def _sigma(residuals: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the standard deviation (S,) of residuals, by the slope of the image: of each of SLOPE_BINS quantiles."""
    edges = np.unique(np.quantile(slope, np.linspace(0, 1, SLOPE_BINS + 1)[1:-1]))
    bins = np.digitize(slope, edges)
    floor = max(0.1 * deviation(residuals), 1e-9)
    deviations = [deviation(residuals[bins == b]) if (bins == b).any() else 0.0 for b in range(len(edges) + 1)]
    return np.maximum(np.array(deviations), floor)[bins]


def _shared(weights: np.ndarray, residuals: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Return weights (S,) that take into account that a patch has an error of its own, given inverse variances (S,).

    Its variance is that of the patches' means, less what the values' own errors give these.
    """
    total = np.bincount(patch, weights)
    counted = (np.bincount(patch, weights > 0) >= FEWEST_IN_PATCH) & (total > 0)
    if not counted.any():
        return weights
    mean = np.bincount(patch, weights * residuals)[counted] / total[counted]
    scale = float(np.sum(weights * residuals**2)) / int(np.count_nonzero(weights))  # 1 if the weights are right
    variance = max(float(np.mean(mean**2 - scale / total[counted])), 0.0)
    return np.asarray(weights / (1 + variance * total[patch]))


def _weights(scaled: np.ndarray, robust: bool) -> np.ndarray:
    """Return weights (S,) of residuals in standard deviations: Tukey's if `robust`, else Huber's."""
    size = np.abs(scaled)
    if robust:
        return np.where(size < TUKEY, (1 - (size / TUKEY) ** 2) ** 2, 0.0)
    return HUBER / np.maximum(size, HUBER)
