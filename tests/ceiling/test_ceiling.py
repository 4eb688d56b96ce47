from dataclasses import replace

import numpy as np
import pytest

from tdgbench.ceiling import Ceiling, Unknown, ceiling
from tdgbench.scenes import ReadOptions, Scene
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset
from tdgbench.scenes.synthetic.render import render
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.scenes.synthetic.write import thermal_image
from tests.helpers.masks import with_garbage

TOLERANCE = 0.5  # dB


def made(root, name: str, errors: CaptureErrors, views: int = 20) -> Scene:
    return SyntheticDataset(
        str(root), ReadOptions(), width=120, height=90, views=views, points=2500, errors=errors
    ).load(name)


def true_ceiling(name: str, scene: Scene, errors: CaptureErrors) -> float:
    """PSNR of the best model, a mean over the training views: renders of the clean world from the given cameras.

    With pose errors, which no model knows, these are averaged over cameras with errors like the scene's.
    """
    rng = np.random.default_rng(1)
    world, draws = WORLDS[name](0), 6 if errors.pose_degrees or errors.pose_units else 1
    found = []
    for view in scene.train:
        cameras = [view.camera] if draws == 1 else [errors.misplaced(view.camera, rng) for _ in range(draws)]
        images = np.array([thermal_image(render(world, camera)[1], world) / 255 for camera in cameras])
        images = images.reshape(draws, *view.thermal.shape)
        error = np.mean((images.mean(axis=0) - view.thermal) ** 2)
        if draws > 1:
            error -= np.mean(images.var(axis=0, ddof=1)) / draws  # of the mean of so few
        found.append(-10 * np.log10(error))
    return float(np.mean(found))


@pytest.mark.parametrize(
    "errors", [CaptureErrors(noise_degC=1.0), CaptureErrors(noise_degC=1.0, drift_degC=1.5)], ids=["noise", "drift"]
)
def test_ceiling_of_known_errors(tmp_path, errors):
    scene = made(tmp_path, "facade", errors)
    found = ceiling(scene)
    assert isinstance(found, Ceiling)
    assert found.psnr == pytest.approx(true_ceiling("facade", scene, errors), abs=TOLERANCE)
    span = scene.temperature.max - scene.temperature.min
    assert found.noise == pytest.approx(errors.noise_degC / span, rel=0.05)
    assert found.drift == pytest.approx(errors.drift_degC / span, rel=0.35, abs=0.004)
    assert found.misregistration == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["facade", "turntable", "orbit", "night"])
@pytest.mark.parametrize(
    "errors",
    [
        CaptureErrors(noise_degC=1.0),
        CaptureErrors(noise_degC=3.0),
        CaptureErrors(noise_degC=1.0, drift_degC=2.0),
        CaptureErrors(noise_degC=0.5, pose_degrees=0.5),
        CaptureErrors(noise_degC=1.0, drift_degC=1.0, pose_degrees=0.3, pose_units=0.02),
    ],
    ids=["noise", "much noise", "drift", "poses", "all"],
)
def test_ceiling_over_levels(tmp_path, name, errors):
    scene = SyntheticDataset(str(tmp_path), ReadOptions(), errors=errors).load(name)
    found = ceiling(scene)
    assert isinstance(found, Ceiling)
    assert found.psnr == pytest.approx(true_ceiling(name, scene, errors), abs=TOLERANCE)


def test_masked_pixels_count_for_nothing(tmp_path):
    scene = made(tmp_path, "facade", CaptureErrors(noise_degC=1.0))
    valid = np.ones((90, 120), bool)
    valid[:30, :30] = False
    clean, hidden = ceiling(scene), []
    for filler in (0.0, 7.0):
        masked = replace(scene, train=[with_garbage(view, valid, filler) for view in scene.train])
        hidden.append(ceiling(masked))
    assert hidden[0] == hidden[1]
    assert hidden[0].psnr == pytest.approx(clean.psnr, abs=0.5)


def test_unknown_without_points(small_gray_scene):
    assert ceiling(replace(small_gray_scene, points=None)) == Unknown("the scene has no sparse points")


def test_unknown_with_few_sightings(small_gray_scene):
    found = ceiling(small_gray_scene)
    assert isinstance(found, Unknown)
    assert "500 are needed" in found.reason


@pytest.mark.slow
def test_the_real_scene(arco_folder):
    from tdgbench.scenes import FolderDataset

    found = ceiling(FolderDataset(str(arco_folder), ReadOptions()).load(None))
    assert isinstance(found, Ceiling)
    assert 22.7 < found.psnr < 28  # a trained model reaches 22.7 dB
