import numpy as np
import pytest

from tdgbench.ceiling.displacement import Displacements, error_by_displacement, find_displacements
from tdgbench.ceiling.images import SmallImage
from tdgbench.ceiling.registration import steepness_at
from tdgbench.ceiling.sightings import find_sightings
from tdgbench.scenes import Camera, ReadOptions, View
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset

CAMERA = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), 256, 64)
CENTRE, DEPTH = np.array([[128.0, 32.0]]), np.ones(1)


def of_waves(noise: float = 0.0) -> View:
    x = np.arange(256) + 0.5
    image = np.sin(2 * np.pi * x / 16)[None].repeat(64, axis=0)
    image = image + np.random.default_rng(1).normal(0, noise, image.shape)
    return View("waves", CAMERA, lambda: image[..., None].astype(np.float32))


def moved(x: float, y: float, variance: float) -> Displacements:
    return Displacements(np.array([[x, y]]), np.array([variance]))


@pytest.mark.parametrize("variance", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("move", [0.0, 1.5])
def test_waves_as_by_random_displacements(variance, move):
    """Of sin(kx) moved by d, against its mean over normal numbers: (1 + b² − 2 b cos(kd)) / 2 with b = exp(−k²σ²/2)."""
    k = 2 * np.pi / 16
    b = np.exp(-(k**2) * variance / 2)
    found = error_by_displacement(of_waves(), CENTRE, DEPTH, moved(move, 0.0, variance), 0.0)
    assert found == pytest.approx((1 + b**2 - 2 * b * np.cos(k * move)) / 2, rel=0.05, abs=2e-3)


def test_noise_is_no_displacement():
    moves = moved(0.7, -0.4, 1.0)
    clean = error_by_displacement(of_waves(), CENTRE, DEPTH, moves, 0.0)
    noisy = error_by_displacement(of_waves(0.3), CENTRE, DEPTH, moves, 0.3**2)
    assert noisy == pytest.approx(clean, abs=0.004)


def test_turned_cameras_are_displaced(tmp_path):
    errors = CaptureErrors(pose_degrees=0.6)
    dataset = SyntheticDataset(str(tmp_path), ReadOptions(), width=120, height=90, views=20, points=2500, errors=errors)
    scene = dataset.load("facade")
    images = [SmallImage.of(view, 1) for view in scene.train]
    sightings = find_sightings(scene.train, scene.points.points)
    steepness, keep = steepness_at(images, sightings)
    keep = sightings.usable(keep)
    sightings, steepness = sightings.kept(keep), steepness[keep]
    found = find_displacements(images, sightings, np.zeros(len(steepness)), steepness)
    true = dataset.shot.cameras(_world(), np.random.default_rng(0))
    names = [view.name for view in scene.views]
    cameras = [true[names.index(view.name)] for view in scene.train]
    moves = sightings.pixels(cameras) - sightings.pixels(sightings.cameras)
    assert found.rms == pytest.approx(np.sqrt(np.mean(moves**2)), rel=0.12, abs=0.1)
    assert np.corrcoef(found.by_view.ravel(), moves.ravel())[0, 1] > 0.9


def _world():
    from tdgbench.scenes.synthetic.worlds import WORLDS

    return WORLDS["facade"](0)
