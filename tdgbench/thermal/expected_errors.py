"""Errors to expect of a thermal camera, as the prior of the fit: their size, and how they change over time.

Sparse points do not determine all parameters. If a camera moves along a surface, a linear vignette, offsets that are
linear in the camera's position, and a linear gradient over the scene cancel in the images. In such directions the prior
chooses the smallest correction.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tdgbench.thermal.maps import TERMS

SHUTTER = 6.0  # standard deviations of the steps between successive views; a larger step is a shutter event
NORMAL = 1.4826  # standard deviation of a normal distribution per median absolute deviation
JITTERS = (0.02, 0.1, 0.3, 0.6, 0.9, 1.0)  # shares of the offsets' variance that change from view to view
LENGTHS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # views, over which the rest of it changes
SPLITS = re.compile(r"(?i)(?<![a-z])(train|eval|test|val)(?![a-z])")  # in names of views
FEWEST = 6  # views with an offset, to tell whether it changes smoothly


def sequence_positions(names: Sequence[str]) -> dict[str, float]:
    """Return the positions of views in the sequence, sorted by the numbers in their names; NaN if a name has none.

    Time stamps and counters in names give the order of capture. `fit_drift` tests whether offsets follow it. Names of
    splits, as in `frame_train_7`, do not count; if names are equal without them, each split has its own counter, and
    all positions are NaN.

    >>> sequence_positions(["img_10", "img_9"]), sequence_positions(["a_eval_2", "a_train_1"])
    ({'img_10': 1.0, 'img_9': 0.0}, {'a_eval_2': 1.0, 'a_train_1': 0.0})
    """
    keys = {name: [part.zfill(20) for part in re.split(r"([0-9]+)", SPLITS.sub("", name))] for name in names}
    if not all(re.search(r"[0-9]", name) for name in names) or len({*map(tuple, keys.values())}) < len(keys):
        return dict.fromkeys(names, float("nan"))
    order = sorted(names, key=keys.__getitem__)
    place = {name: float(number) for number, name in enumerate(order)}
    return {name: place[name] for name in names}


def kind_of_name(name: str) -> str:
    """Return a name without its numbers and that of its split: views of another kind are of another sequence.

    >>> kind_of_name("frame_train_0007"), kind_of_name("frame_eval_0012")
    ('frame__#', 'frame__#')
    """
    return re.sub(r"[0-9]+", "#", SPLITS.sub("", name))


class ExpectedErrors(NamedTuple):
    """Standard deviations of a camera's errors, in the scene's unit, but of gains.

    vignette: of its quadratic terms, over the image; of linear ones half as much, of each degree above half of that
    below.
    """

    offsets: float
    gains: float
    vignette: float

    @classmethod
    def in_unit(cls, unit: str, spread: float) -> ExpectedErrors:
        """Return them for a unit. spread: standard deviation of the scene's values.

        In °C: uncooled cameras are off by up to ±5 °C in a flight (Kelly et al. 2019), and exact to some 5 % (FLIR
        Lepton Engineering Datasheet 500-0659-00-09). Images of automatic gain control are stretched by any factor.
        """
        if unit == "°C":
            return cls(2.0, 0.05, 0.7)
        return cls(0.5 * spread, 0.3, 0.2 * spread)

    def of_vignette(self) -> np.ndarray:
        """Return the standard deviations (K,) of the polynomials' coefficients."""
        by_degree = {1: 0.5, 2: 1.0, 3: 0.5, 4: 0.25}
        return self.vignette * np.array([by_degree[sum(degrees)] for degrees in TERMS])


class Drift(NamedTuple):
    """Model of offsets along the sequence: a Matérn process, with jumps at shutter events, plus independent jitter."""

    variance: float
    jitter: float  # share of the variance that is independent from view to view
    length: float  # views
    events: tuple[float, ...] = ()  # positions between views at which the shutter closed

    def covariance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the covariance (A, B) of the smooth part of offsets at positions (A,) and (B,): Matérn, ν = 3/2."""
        far = np.sqrt(3) * np.abs(a[:, None] - b[None]) / self.length
        same = np.searchsorted(self.events, a)[:, None] == np.searchsorted(self.events, b)[None]
        return np.asarray(self.variance * (1 - self.jitter) * (1 + far) * np.exp(-far) * same)

    def offset_covariance(self, positions: np.ndarray) -> np.ndarray:
        """Return the covariance (V, V) of the offsets at positions (V,)."""
        jitter = self.variance * max(self.jitter, JITTERS[0])
        return self.covariance(positions, positions) + jitter * np.eye(len(positions))

    def expected(self, at: np.ndarray, positions: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """Interpolate the offsets (V,) of views at positions (V,) at other positions (A,) (Gaussian-process mean)."""
        return np.asarray(self.covariance(at, positions) @ np.linalg.solve(self.offset_covariance(positions), offsets))


def fit_drift(positions: np.ndarray, offsets: np.ndarray, known: np.ndarray, width: float) -> Drift:
    """Fit the drift to estimated offsets (V,) at positions (V,) by maximum likelihood.

    known: (V,) mask of views whose offset was estimated. width: upper bound of the standard deviation of offsets.
    """
    x, y = positions[known], offsets[known]
    variance = float(np.mean(y**2))
    if len(x) < FEWEST or variance <= 0:
        return Drift(width**2, 1.0, LENGTHS[0])
    events = shutter_events(x, y)
    tried = [Drift(1.0, jitter, length, events) for jitter in JITTERS for length in LENGTHS]
    best = max(tried, key=lambda drift: _likelihood(drift, x, y))
    return best._replace(variance=min(variance, width**2))


def shutter_events(positions: np.ndarray, offsets: np.ndarray) -> tuple[float, ...]:
    """Return the positions between successive views at which the offset jumps by far more than usual."""
    order = np.argsort(positions)
    x, steps = positions[order], np.diff(offsets[order])
    usual = NORMAL * float(np.median(np.abs(steps - np.median(steps))))
    jumps = np.abs(steps - np.median(steps)) > SHUTTER * max(usual, 1e-12)
    return tuple(float(place) for place in ((x[1:] + x[:-1]) / 2)[jumps])


def _likelihood(drift: Drift, x: np.ndarray, y: np.ndarray) -> float:
    """Return the log likelihood of offsets, their variance being that which fits best."""
    factor = cho_factor(drift.offset_covariance(x), lower=True)
    spread = float(y @ cho_solve(factor, y)) / len(y)
    return -0.5 * len(y) * np.log(spread) - float(np.log(np.diag(factor[0])).sum())
