"""How far a fitted response is evidence: directions that parts of the scene contradict each other about are held back.

Errors that the model does not describe (reflections, sunlit slopes, points that moved) are alike over large parts of a
scene. In a direction that the values hardly determine they become large, and no standard error shows it. A jackknife
over clusters of points does: what changes as much as it is large when a part of the scene is left out is not known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.thermal.camera import ViewResponses
from tdgbench.thermal.fit import Data, Fit, System, Terms, deviation, predict

LEAST = 1e-9  # variance of a direction, in those of the prior


def held_back(data: Data, found: Fit, terms: Terms, precision: np.ndarray) -> Fit:
    """Return the fit, each direction shrunk towards an ideal camera by what the jackknife leaves of its evidence."""
    free = terms.free(data)
    if not free.any():
        return found
    theta = np.concatenate([*found.response, found.vignette])
    system = System(data, theta, found.temperatures, found.reference, found.weights)
    told, axes = system.directions(precision, free)
    given = precision[np.ix_(free, free)]
    others = [_without(data, found, theta, precision, free, cluster) for cluster in np.unique(data.cluster)]
    moved = np.stack(others)[:, free] @ given @ axes
    count = len(others)
    variance = (count - 1) / count * np.sum((moved - moved.mean(axis=0)) ** 2, axis=0)
    drawn = told / (told + 1)  # the share of a value that the prior leaves
    known = np.minimum(told, drawn**2 / np.maximum(variance, LEAST))
    place = (theta - data.ideal)[free] @ given @ axes
    kept = np.where(drawn > 0, place / np.maximum(drawn, LEAST), 0.0) * known / (known + 1)
    theta = data.ideal
    theta[free] += axes @ kept
    temperatures = _temperatures(data, theta, found)
    residuals = data.value - predict(data, theta, temperatures, found.reference)
    response = ViewResponses(theta[: data.views], theta[data.views : 2 * data.views])
    return replace(
        found, response=response, vignette=theta[2 * data.views :], temperatures=temperatures, residuals=residuals,
        after=deviation(residuals), known=lambda: known,
    )  # fmt: skip


def _without(
    data: Data, found: Fit, theta: np.ndarray, precision: np.ndarray, free: np.ndarray, cluster: int
) -> np.ndarray:  # fmt: skip
    """Change (2 V + K,) of the parameters if a cluster of points is left out."""
    keep = data.cluster != cluster
    rest, residuals = data.kept(keep), found.residuals[keep]
    system = System(rest, theta, found.temperatures, found.reference, found.weights[keep])
    return system.solve(residuals, precision @ (data.ideal - theta), precision, free)


def _temperatures(data: Data, theta: np.ndarray, found: Fit) -> np.ndarray:
    """Return temperatures (P,) that fit the values best, given the other parameters."""
    system = System(data, theta, found.temperatures, found.reference, found.weights)
    residuals = data.value - predict(data, theta, found.temperatures, found.reference)
    return found.temperatures + system.temperature_step(residuals, np.zeros(len(theta)))
