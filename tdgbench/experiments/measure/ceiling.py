"""The ceiling of made scenes by calculation, for comparison with the one that `tdgbench.ceiling` estimates.

The best prediction of a captured image, in mean squared error, is its expectation given all that a model can know. A
model that knows the scene perfectly, and cameras as they are given, does not know a view's noise, drift and pose error.
So the expectation over these three is what no model exceeds on average, from however many views it learns.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from tdgbench.ceiling import HIGHEST, Unknown, ceiling
from tdgbench.scenes import Camera, Scene
from tdgbench.scenes.synthetic import CaptureErrors, Rig, SyntheticDataset
from tdgbench.scenes.synthetic.render import cast
from tdgbench.scenes.synthetic.thermal_camera import ThermalErrors
from tdgbench.scenes.synthetic.thermal_files import thermal_image
from tdgbench.scenes.synthetic.world import World
from tdgbench.scenes.synthetic.worlds import WORLDS

STEPS = 4096  # of the temperature range in which expected values are tabulated
SMALLEST = 1e-10  # mean squared error
MARGIN = 0.5  # share of the temperature range that they go beyond it on each side
GRID = 2  # px between the pixels of a view that are compared
PAIRS = 8  # of pose errors, each with its opposite
SAMPLES = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])  # in a pixel, as images are made


ERRORS = {
    "none": CaptureErrors(),
    "noise": CaptureErrors(noise_degC=0.5),
    "much noise": CaptureErrors(noise_degC=2.0),
    "drift": CaptureErrors(drift_degC=1.0),
    "turns": CaptureErrors(pose_degrees=0.5),
    "displacements": CaptureErrors(pose_units=0.02),
    "noise, drift": CaptureErrors(noise_degC=1.0, drift_degC=1.0),
    "all": CaptureErrors(noise_degC=1.0, drift_degC=1.0, pose_degrees=0.3, pose_units=0.02),
}


class Comparison(NamedTuple):
    """Ceilings of a made scene, dB, and the estimate's seconds (images are read before)."""

    truth: float
    predicted: float
    seconds: float

    @property
    def difference(self) -> float:
        """0 where the estimate says no more than that the ceiling is above HIGHEST, and it is."""
        return 0.0 if self.truth > HIGHEST and self.predicted == HIGHEST else self.predicted - self.truth


def compare(dataset: SyntheticDataset, name: str) -> Comparison:
    """The estimated and the calculated ceiling of a made scene. Raises ValueError if the estimate is unknown."""
    scene = dataset.load(name)
    for view in scene.train:
        view.thermal  # noqa: B018  # read it
    start = time.perf_counter()
    found = ceiling(scene)
    seconds = time.perf_counter() - start
    if isinstance(found, Unknown):
        raise ValueError(f"the ceiling of {name} is unknown: {found.reason}")
    return Comparison(true_ceiling(dataset, scene), found.psnr, seconds)


def true_ceiling(dataset: SyntheticDataset, scene: Scene) -> float:
    """Mean over the training views of the PSNR, dB, of the expected image against the captured one.

    The drifts' mean cannot be told from the scene's temperature and belongs to it. The expectation over poses is a mean
    over draws; what so few of them add to the squared error is subtracted. Raises ValueError for errors of the thermal
    camera and its rig, which are not calculated here.
    """
    if dataset.shot.errors.camera != ThermalErrors() or dataset.shot.errors.rig != Rig():
        raise ValueError(
            "the ceiling is calculated for noise, drift and pose errors, not for dataset.loader.errors.camera or rig"
        )
    shot = dataset.shot
    world = WORLDS[scene.name](shot.seed).with_gradient(shot.errors.gradient_degC)
    errors, rng, found = shot.errors, np.random.default_rng(shot.seed), []
    names = [view.name for view in scene.views]
    drift = errors.drifts(shot.views, shot.seed)[[names.index(view.name) for view in scene.train]].mean()
    expected = ExpectedValues(world, float(np.hypot(errors.noise_degC, errors.drift_degC)))
    posed = errors.pose_degrees > 0 or errors.pose_units > 0
    for view in scene.train:
        first = rng.integers(0, GRID, 2)
        rows, columns = (a.ravel() for a in np.mgrid[first[0] : shot.height : GRID, first[1] : shot.width : GRID])
        corners = np.stack([columns, rows], axis=1)
        images = []
        for index, sizes in enumerate(rng.normal(size=(PAIRS, 6)) if posed else np.zeros((1, 6))):
            cameras = (errors.moved(view.camera, one) for one in (sizes, -sizes)) if posed else (view.camera,)
            offsets = SAMPLES[index % 4][None] if posed else SAMPLES  # draws of poses are draws in a pixel as well
            pair = [expected(_degC(world, camera, corners, offsets) + drift) for camera in cameras]
            images.append(np.mean(pair, axis=0))
        error = np.square(view.thermal[rows, columns] - np.mean(images, axis=0)).mean()
        if posed:
            error -= np.var(images, axis=0, ddof=1).mean() / PAIRS
        found.append(-10 * np.log10(max(error, SMALLEST)))
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


def _degC(world: World, camera: Camera, corners: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Mean temperatures (N,) of the pixels at `corners` (N, 2), at `offsets` (M, 2) in them."""
    return np.mean([cast(world, camera, corners + offset)[1] for offset in offsets], axis=0)
