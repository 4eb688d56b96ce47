"""Choose and fit the response that explains the values of points in different views.

Held-out views decide which terms are fitted. A jackknife over clusters of points then shrinks uncertain parameters.
Errors outside the model (reflections, sunlit slopes, moving points) are correlated over large parts of a scene. They
become large in directions that the values hardly determine, and standard errors do not show them. A direction whose
estimate varies as much as it is large when a cluster is left out is shrunk towards an ideal camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.thermal.camera import ViewResponses
from tdgbench.thermal.expected_errors import NORMAL, Drift, ExpectedErrors, fit_drift
from tdgbench.thermal.fit import HUBER, Fit, System, Terms, deviation, fit, predict
from tdgbench.thermal.maps import TERMS
from tdgbench.thermal.observations import PointSamples

LADDER = (  # from the simplest
    Terms(), Terms(vignette=True), Terms(offsets=True), Terms(vignette=True, offsets=True),
    Terms(offsets=True, gains=True), Terms(vignette=True, offsets=True, gains=True),
)  # fmt: skip
FOLDS = 4  # groups of views that are held out in turn
BETTER = 0.98  # share of the simpler terms' error that further ones must reach
BETTER_WITH_GAINS = 0.9  # of gains, which blur and misregistration of a view look like
POINTS_TO_CHOOSE = 3_000
CUT = 3.0  # standard deviations; larger errors of prediction count as this large
FEWEST_VALUES = 10  # of a held-out view
FIT_ROUNDS = 10
RIGHTWARDS = TERMS.index((1, 0))  # the polynomial that is positive in the right half of an image
MIN_VARIANCE = 1e-9  # variance of a direction, in those of the prior


def fit_selected_terms(
    data: PointSamples, stds: ExpectedErrors, positions: np.ndarray
) -> tuple[Fit, Terms, Drift | None]:
    """Fit the terms that held-out views support. positions: (V,) of the views in the sequence, NaN if unknown."""
    terms = choose_terms(data, stds, positions)
    fitted = fit(data, terms, prior_precision(data, stds))
    drift = _drift(fitted, data, terms, stds, positions)
    precision = prior_precision(data, stds, drift, positions)
    if drift is not None:
        fitted = fit(data, terms, precision)
    return shrink_towards_ideal(data, fitted, terms, precision), terms, drift


def choose_terms(data: PointSamples, stds: ExpectedErrors, positions: np.ndarray) -> Terms:
    """Choose the simplest terms that clearly improve the prediction of held-out views.

    A drift outside the model, or a reflection, can look like a gain; held-out views show that correcting it does not
    improve the temperatures of the points. Two errors are measured, as for test views: without reading any value of the
    view, and after the gain and offset fitted to its other half. Terms must lower one of them, and their product.
    """
    some = data.select(data.point % max(1, -(-data.points // POINTS_TO_CHOOSE)) == 0)
    best, least = LADDER[0], held_out_errors(some, LADDER[0], stds, positions)
    for terms in LADDER[1:]:
        errors = held_out_errors(some, terms, stds, positions)
        change = [_size(b, a) / _size(a, a) for a, b in zip(least, errors, strict=True)]
        needed = BETTER_WITH_GAINS if terms.gains and not best.gains else BETTER
        if min(change) < needed and change[0] * change[1] < needed:
            best, least = terms, errors
    if best.vignette and not _needs_vignette(some, best, least[1], stds, positions):
        return best._replace(vignette=False, offsets=True)
    return best


def _needs_vignette(
    data: PointSamples, terms: Terms, halves: np.ndarray, stds: ExpectedErrors, positions: np.ndarray
) -> bool:
    """Return whether offsets alone do not explain as much with more likely numbers.

    Along a line, a tilted vignette and a drift show the points alike. What tells them apart is the other half of an
    image, whose errors (S,) with these terms are `halves`, and else the prior: a tilt must be large where steps are
    small.
    """
    plain = terms._replace(vignette=False, offsets=True)
    _, of_plain = held_out_errors(data, plain, stds, positions)
    if _size(of_plain, halves) > _size(halves, halves) / BETTER:
        return True
    precision, costs = prior_precision(data, stds), []
    for some in (terms, plain):
        fitted = fit(data, some, precision)
        change = np.concatenate([*fitted.response, fitted.vignette]) - data.ideal
        costs.append(float(change @ precision @ change))
    return costs[0] <= costs[1]


def prior_precision(
    data: PointSamples, stds: ExpectedErrors, drift: Drift | None = None, positions: np.ndarray | None = None
) -> np.ndarray:
    """Return the precision (2 V + K, 2 V + K) of the parameters. drift: of the offsets; None: each has its std."""
    variances = np.r_[np.full(data.views, stds.gains**2), stds.of_vignette() ** 2]
    precision = np.diag(1 / np.r_[np.full(data.views, stds.offsets**2), variances])
    if drift is not None and positions is not None:
        precision[: data.views, : data.views] = np.linalg.inv(drift.offset_covariance(positions))
    return precision


def _drift(fitted: Fit, data: PointSamples, terms: Terms, stds: ExpectedErrors, positions: np.ndarray) -> Drift | None:
    """Fit how the offsets change along the sequence; None if offsets are not estimated or there is no sequence."""
    if not terms.offsets or np.isnan(positions).any():
        return None
    offsets, known = fitted.response.offsets, np.bincount(data.view, minlength=data.views) > 0
    return fit_drift(positions, offsets - offsets[known].mean(), known, stds.offsets)


def _size(errors: np.ndarray, simplest: np.ndarray) -> float:
    """Return the root mean square of errors (S,), cut off at CUT robust standard deviations of the simplest model's."""
    if not simplest.size:
        return 1.0
    cut = CUT * NORMAL * float(np.median(np.abs(simplest)))
    return float(np.sqrt(np.mean(np.minimum(errors**2, cut**2)))) or 1e-12


def held_out_errors(
    data: PointSamples, terms: Terms, stds: ExpectedErrors, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the values of views, held out in turn, from the points' temperatures in other views; return two errors.

    The first use no value of the view: its offset is interpolated from its neighbours in the sequence, its gain is 1.
    The second are after the gain and offset that fit the other half of the image.
    """
    present = np.unique(data.view)
    unread, halves = [np.zeros(0)], [np.zeros(0)]
    for fold in range(FOLDS):
        held = np.isin(data.view, present[fold::FOLDS])
        rest = data.select(~held)
        seen = np.bincount(rest.point, minlength=data.points) >= 2
        fitted = fit(rest, terms, prior_precision(data, stds))
        drift = _drift(fitted, rest, terms, stds, positions)
        expected = np.zeros(data.views)
        if drift is not None:
            known = np.unique(rest.view)
            expected = drift.expected(positions, positions[known], fitted.response.offsets[known])
        test = data.select(held & seen[data.point])
        shown = test.value - test.terms @ fitted.vignette
        for view in np.unique(test.view):
            of_view = test.view == view
            predicted, value = fitted.temperatures[test.point[of_view]], shown[of_view]
            unread.append(value - predicted - expected[view])
            halves.append(_halves(predicted, value, test.terms[of_view, RIGHTWARDS] > 0))
    return np.concatenate(unread), np.concatenate(halves)


def _halves(x: np.ndarray, y: np.ndarray, is_right: np.ndarray) -> np.ndarray:
    """Return errors (N,) of values in each half of an image, after the robust line through those of the other half."""
    left = [np.zeros(0)]
    for half in (is_right, ~is_right):
        if np.count_nonzero(~half) >= FEWEST_VALUES and half.any():
            gain, offset = _line(x[~half], y[~half])
            left.append(y[half] - gain * x[half] - offset)
    return np.concatenate(left)


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the gain and offset of a robust line through values."""
    terms, weights = np.stack([x - x.mean(), np.ones_like(x)], axis=1), np.ones_like(x)
    line = np.zeros(2)
    for _ in range(FIT_ROUNDS):
        root = np.sqrt(weights)
        line = np.linalg.lstsq(terms * root[:, None], y * root, rcond=None)[0]
        left = y - terms @ line
        sigma = max(NORMAL * float(np.median(np.abs(left))), 1e-9)
        weights = HUBER / np.maximum(np.abs(left) / sigma, HUBER)
    return float(line[0]), float(line[1] - line[0] * x.mean())


def shrink_towards_ideal(data: PointSamples, fitted: Fit, terms: Terms, precision: np.ndarray) -> Fit:
    """Shrink each direction of a fit towards an ideal camera, by its variance under the jackknife."""
    free = terms.free(data)
    if not free.any():
        return fitted
    theta = np.concatenate([*fitted.response, fitted.vignette])
    system = System(data, theta, fitted.temperatures, fitted.reference, fitted.weights)
    information, axes = system.directions(precision, free)
    given = precision[np.ix_(free, free)]
    others = [_change_without(data, fitted, theta, precision, free, cluster) for cluster in np.unique(data.cluster)]
    moved = np.stack(others)[:, free] @ given @ axes
    count = len(others)
    variance = (count - 1) / count * np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
    drawn = information / (information + 1)  # the share of a value that the prior leaves
    known = np.minimum(information, drawn**2 / np.maximum(variance, MIN_VARIANCE))
    place = (theta - data.ideal)[free] @ given @ axes
    kept = np.where(drawn > 0, place / np.maximum(drawn, MIN_VARIANCE), 0.0) * known / (known + 1)
    theta = data.ideal
    theta[free] += axes @ kept
    system = System(data, theta, fitted.temperatures, fitted.reference, fitted.weights)
    residuals = data.value - predict(data, theta, fitted.temperatures, fitted.reference)
    temperatures = fitted.temperatures + system.temperature_step(residuals, np.zeros(len(theta)))
    residuals = data.value - predict(data, theta, temperatures, fitted.reference)
    response = ViewResponses(theta[: data.views], theta[data.views : 2 * data.views])
    return replace(
        fitted, response=response, vignette=theta[2 * data.views :], temperatures=temperatures, residuals=residuals,
        after=deviation(residuals), known=lambda: known,
    )  # fmt: skip


def _change_without(
    data: PointSamples, fitted: Fit, theta: np.ndarray, precision: np.ndarray, free: np.ndarray, cluster: int
) -> np.ndarray:
    """Return the change (2 V + K,) of the parameters when a cluster of points is left out."""
    keep = data.cluster != cluster
    rest, residuals = data.select(keep), fitted.residuals[keep]
    system = System(rest, theta, fitted.temperatures, fitted.reference, fitted.weights[keep])
    return system.solve(residuals, precision @ (data.ideal - theta), precision, free)
