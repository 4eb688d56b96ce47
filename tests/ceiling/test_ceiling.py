from dataclasses import replace

import numpy as np
import pytest

from tdgbench.ceiling import HIGHEST, Ceiling, Unknown, ceiling
from tdgbench.experiments.measure.ceiling import ERRORS, compare
from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset
from tdgbench.scenes.synthetic.surveys import SURVEYS
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.masks import with_garbage

TOLERANCE = 0.5  # dB


def made(root, errors: CaptureErrors) -> SyntheticDataset:
    """A data set of small scenes."""
    return SyntheticDataset(str(root), ReadOptions(), width=120, height=90, views=20, points=2500, errors=errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "errors"),
    [
        *(("facade", errors) for errors in ERRORS),
        *((name, "all") for name in WORLDS if name not in ("facade", *SURVEYS)),
    ],
)
def test_ceilings_of_scenes(tmp_path, name, errors, request):
    """Each kind of error on one scene, all of them on the others; `benchmarks.ceiling` compares every pair."""
    if (name, errors) == ("turntable", "all"):
        request.applymarker(
            pytest.mark.xfail(reason="of few views that share a point, displacements are found too small")
        )
    found = compare(SyntheticDataset(str(tmp_path), ReadOptions(), errors=ERRORS[errors]), name)
    assert abs(found.difference) <= TOLERANCE


def test_parts_of_noise_and_drift(tmp_path):
    errors = CaptureErrors(noise_degC=1.0, drift_degC=1.5)
    dataset = made(tmp_path, errors)
    scene = dataset.load("facade")
    found = ceiling(scene)
    span = scene.temperature.max - scene.temperature.min
    names = [view.name for view in scene.views]
    drifts = errors.drifts(20, 0)[[names.index(view.name) for view in scene.train]]
    assert found.noise == pytest.approx(1.0 / span, rel=0.03)
    assert found.drift == pytest.approx(drifts.std() / span, rel=0.05)
    assert found.other < 0.2 * found.noise


def test_without_errors_nothing_limits(tmp_path):
    found = ceiling(made(tmp_path, CaptureErrors()).load("facade"))
    assert found.psnr == HIGHEST
    assert str(found).startswith("more than 45 dB")


def test_masked_pixels_count_for_nothing(tmp_path):
    scene = made(tmp_path, CaptureErrors(noise_degC=1.0)).load("facade")
    valid = np.ones((90, 120), bool)
    valid[:30, :30] = False
    hidden = []
    for filler in (0.0, 7.0):
        masked = replace(scene, train=[with_garbage(view, valid, filler) for view in scene.train])
        hidden.append(ceiling(masked))
    assert hidden[0] == hidden[1]
    assert hidden[0].noise == pytest.approx(1 / (scene.temperature.max - scene.temperature.min), rel=0.05)


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
    assert 23.4 < found.psnr < 28  # a trained model reaches 23.4 dB
