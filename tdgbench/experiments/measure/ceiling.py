"""The ceiling of made scenes by calculation, for comparison with the one that `tdgbench.ceiling` estimates.

The best prediction of a captured image, in mean squared error, is its expectation given all that a model can know. A
model that knows the scene perfectly, and cameras as they are given, does not know a view's noise, drift and pose error.
So the expectation over these three is what no model exceeds on average, from however many views it learns.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, qmc

from tdgbench.scenes import Scene, View
from tdgbench.scenes.synthetic import CaptureErrors
from tdgbench.scenes.synthetic.render import cast
from tdgbench.scenes.synthetic.worlds import World
from tdgbench.scenes.synthetic.write import thermal_image

STEPS = 4096  # of the temperature range in which expected values are tabulated
MARGIN = 0.5  # share of the temperature range that they go beyond it on each side
PIXELS = 1000  # of a view that are compared
DRAWS = 32  # of pose errors; a power of 2
SAMPLES = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])  # in a pixel, as images are made


def true_ceiling(world: World, scene: Scene, errors: CaptureErrors, drifts: np.ndarray, seed: int = 0) -> float:
    """Mean over the training views of the PSNR, dB, of the expected image against the captured one.

    drifts: (V,) of the training views, °C. Their mean cannot be told from the scene's temperature and belongs to it.
    """
    rng = np.random.default_rng(seed)
    expected = ExpectedValues(world, float(np.hypot(errors.noise_degC, errors.drift_degC)))
    posed = errors.pose_degrees > 0 or errors.pose_units > 0
    found = []
    for view in scene.train:
        rows, columns = rng.integers(0, view.camera.height, PIXELS), rng.integers(0, view.camera.width, PIXELS)
        corners = np.stack([columns, rows], axis=1)
        cameras = [errors.moved(view.camera, sizes) for sizes in _pose_errors(rng)] if posed else [view.camera]
        draws = np.stack([expected(_degC(world, camera, corners) + drifts.mean()) for camera in cameras])
        found.append(-10 * np.log10(np.square(view.thermal[rows, columns] - draws.mean(axis=0)).mean()))
    return float(np.mean(found))


class ExpectedValues:
    """Expected image values at temperatures with a normally distributed error, °C: encoding is not linear."""

    def __init__(self, world: World, error: float) -> None:
        low, high = world.temperatures
        reach = MARGIN * (high - low)
        self.degC = np.linspace(low - reach, high + reach, STEPS)
        values = thermal_image(self.degC[None], world)[0].reshape(STEPS, -1) / 255
        step = self.degC[1] - self.degC[0]
        if error > 0:
            count = int(np.ceil(5 * error / step))
            kernel = norm.pdf(np.arange(-count, count + 1) * step / error)
            padded = np.pad(values, ((count, count), (0, 0)), mode="edge")
            values = np.stack([np.convolve(one, kernel / kernel.sum(), "valid") for one in padded.T], axis=1)
        self.values = values

    def __call__(self, degC: np.ndarray) -> np.ndarray:
        """Values (N, C) at temperatures (N,)."""
        return np.stack([np.interp(degC, self.degC, channel) for channel in self.values.T], axis=1)


def _degC(world: World, camera, corners: np.ndarray) -> np.ndarray:
    """Mean temperatures (N,) of the pixels at `corners` (N, 2)."""
    return np.mean([cast(world, camera, corners + offset)[1] for offset in SAMPLES], axis=0)


def _pose_errors(rng: np.random.Generator) -> np.ndarray:
    """Draws (DRAWS, 6) of standard normal numbers, spread evenly: the mean of each is 0."""
    half = norm.ppf(qmc.Sobol(6, rng=rng).random(DRAWS // 2))
    return np.concatenate([half, -half])
