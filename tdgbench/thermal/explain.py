"""What explains the values of points in different views: a response and a fixed pattern that held-out views support."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tdgbench.thermal.fit import HUBER, NORMAL, Data, Fit, Terms, fit
from tdgbench.thermal.pattern import line_pattern
from tdgbench.thermal.sightings import BLUR

PASSES = 2  # over response and fixed pattern
LADDER = (Terms(), Terms(vignette=True), Terms(vignette=True, offsets=True), Terms(True, True, gains=True))
FOLDS = 4  # groups of views that are held out in turn
BETTER = 0.98  # share of the simpler terms' error that further ones must reach
POINTS_TO_CHOOSE = 4_000
CUT = 3.0  # standard deviations; larger errors of prediction count as this large
FEWEST_VALUES = 10  # of a held-out view
FIT_ROUNDS = 10

Lines = tuple[np.ndarray | None, np.ndarray | None]  # fixed pattern by columns and by rows


@dataclass(frozen=True)
class Explained:
    """A fit; columns (W,) and rows (H,) of the fixed pattern, None where there is none."""

    fit: Fit
    columns: np.ndarray | None = None
    rows: np.ndarray | None = None

    def blurred(self, data: Data) -> np.ndarray:
        """Fixed pattern (S,) in the blurred values."""
        return _at(_smooth(self.columns), _smooth(self.rows), data)


def explain(data: Data, gain_prior: float) -> tuple[Explained, Terms]:
    """Fit the terms that held-out views support. Response and fixed pattern take turns."""
    terms = choose_terms(data, gain_prior)
    best = Explained(fit(data, terms, gain_prior))
    for _ in range(PASSES if data.size != (0, 0) else 0):
        weights = best.fit.weights
        left = best.fit.residuals + best.blurred(data) + _within_points(data.detail, weights, data)
        lines = _lines(data, left, weights)
        if not terms.pattern:
            shown = [left, left - _held_out_pattern(data, left, weights)]
            terms = terms._replace(pattern=_simplest([one[weights > 0] for one in shown]) == 1)
        if not terms.pattern:
            break
        cleaned = replace(data, value=data.value - Explained(best.fit, *lines).blurred(data))
        best = Explained(replace(fit(cleaned, terms, gain_prior), before=best.fit.before), *lines)
    return best, terms


def choose_terms(data: Data, gain_prior: float) -> Terms:
    """The simplest terms with which the other views predict held-out views nearly best.

    A drift that the terms do not describe, or a reflection, can look like a gain. Correcting it would not make the
    temperatures of the points truer, which views that were not used for it tell.
    """
    some = data.kept(data.point % max(1, -(-data.points // POINTS_TO_CHOOSE)) == 0)
    return LADDER[_simplest([held_out_errors(some, terms, gain_prior) for terms in LADDER])]


def _within_points(values: np.ndarray, weights: np.ndarray, data: Data) -> np.ndarray:
    """Values (S,) less the weighted mean of their point."""
    total = np.maximum(np.bincount(data.point, weights, data.points), 1e-12)
    return values - (np.bincount(data.point, weights * values, data.points) / total)[data.point]


def _lines(data: Data, left: np.ndarray, weights: np.ndarray) -> Lines:
    """Patterns of columns and rows of what is left (S,) of the values."""
    columns = line_pattern(left, weights, data.column, data.size[0])
    rows = line_pattern(left - _at(columns, None, data), weights, data.row, data.size[1])
    return columns, rows


def _held_out_pattern(data: Data, left: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fixed pattern (S,) at values, each from views of other folds."""
    pattern, fold = np.zeros(len(left)), data.view % FOLDS
    for one in range(FOLDS):
        pattern[fold == one] = _at(*_lines(data, left, np.where(fold == one, 0, weights)), data)[fold == one]
    return pattern


def _simplest(errors: list[np.ndarray]) -> int:
    """The first of several models, by their errors (S,) of the same values, that a later one does not clearly beat."""
    cut = CUT * min(NORMAL * float(np.median(np.abs(one))) for one in errors)
    size = [float(np.sqrt(np.mean(np.minimum(one**2, cut**2)))) for one in errors]
    best = 0
    for index in range(1, len(size)):
        if size[index] < BETTER * size[best]:
            best = index
    return best


def held_out_errors(data: Data, terms: Terms, gain_prior: float) -> np.ndarray:
    """Errors of the values of views that are held out in turn, predicted from the points' temperatures in other views.

    The offset and gain of a held-out view are unknown; they are fitted to its values.
    """
    present = np.unique(data.view)
    errors = []
    for fold in range(FOLDS):
        held = np.isin(data.view, present[fold::FOLDS])
        rest = data.kept(~held)
        seen = np.bincount(rest.point, minlength=data.points) >= 2
        found = fit(rest, terms, gain_prior)
        test = data.kept(held & seen[data.point])
        shown = test.value - test.terms @ found.vignette
        for view in np.unique(test.view):
            of_view = test.view == view
            if np.count_nonzero(of_view) >= FEWEST_VALUES:
                errors.append(_affine_residuals(found.temperatures[test.point[of_view]], shown[of_view]))
    return np.concatenate(errors) if errors else np.zeros(1)


def _affine_residuals(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Residuals (N,) of a robust line through values."""
    terms, weights = np.stack([x - x.mean(), np.ones_like(x)], axis=1), np.ones_like(x)
    for _ in range(FIT_ROUNDS):
        root = np.sqrt(weights)
        line = np.linalg.lstsq(terms * root[:, None], y * root, rcond=None)[0]
        left = y - terms @ line
        sigma = max(NORMAL * float(np.median(np.abs(left))), 1e-9)
        weights = HUBER / np.maximum(np.abs(left) / sigma, HUBER)
    return left


def _smooth(lines: np.ndarray | None) -> np.ndarray | None:
    return None if lines is None else gaussian_filter1d(lines, BLUR, mode="nearest")


def _at(columns: np.ndarray | None, rows: np.ndarray | None, data: Data) -> np.ndarray:
    """Pattern (S,) of columns and rows at values."""
    across = 0.0 if columns is None else columns[data.column]
    return np.zeros(len(data.value)) + across + (0.0 if rows is None else rows[data.row])
