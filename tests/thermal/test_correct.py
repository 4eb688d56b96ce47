from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes import SceneError
from tdgbench.thermal import correct_values, corrected
from tests.helpers.layouts import celsius


def worst(scene, clean, views):
    """Largest RMS difference in °C of views from the clean ones, whose mean over all is that of the scene."""
    by_name = {view.name: celsius(view, clean) for view in clean.views}
    differences = [celsius(view, scene) - by_name[view.name] for view in views]
    return max(np.sqrt(np.mean(np.square(one - np.mean(differences)))) for one in differences)


def test_corrected_training_views_are_as_those_of_an_ideal_camera(drifting_scene, drifting_camera, clean_scene):
    scene = corrected(drifting_scene, drifting_camera)
    assert worst(drifting_scene, clean_scene, drifting_scene.train) > 2
    assert worst(scene, clean_scene, scene.train) < 0.25  # the gauge: gains of mean 1 scale the scene by some 0.5 %
    assert scene.temperature == drifting_scene.temperature and scene.points is drifting_scene.points
    assert "test views are as they are" in " ".join(scene.notes) and "outside of the image's range" in scene.notes[-1]


def test_test_views_are_as_they_are_by_default(drifting_scene, drifting_camera):
    scene = corrected(drifting_scene, drifting_camera)
    for before, after in zip(drifting_scene.test, scene.test, strict=True):
        assert np.array_equal(before.thermal, after.thermal)


def test_shared_terms_can_be_removed_from_test_views(drifting_scene, drifting_camera):
    scene = corrected(drifting_scene, drifting_camera, test="shared")
    span = scene.temperature.max - scene.temperature.min
    for before, after in zip(drifting_scene.test, scene.test, strict=True):
        removed = span * (before.thermal - after.thermal)[..., 0]
        inside = (after.thermal[..., 0] > 0) & (after.thermal[..., 0] < 1)
        assert np.abs(removed - drifting_camera.shared(64, 48))[inside].max() < 1e-3


def test_correction_inverts_the_response(drifting_scene, drifting_camera):
    view = drifting_scene.train[3]
    degC = celsius(view, drifting_scene).astype(np.float64)
    ideal = correct_values(degC, view.name, drifting_camera)
    offset, gain = drifting_camera.of_view(view.name)
    again = drifting_camera.reference + gain * (ideal - drifting_camera.reference) + offset
    assert np.allclose(again + drifting_camera.shared(64, 48), degC)


def test_masked_pixels_stay_masked(drifting_scene, drifting_camera):
    valid = np.ones((48, 64), bool)
    valid[:10] = False
    masked = [replace(view, load_valid=lambda: valid) for view in drifting_scene.train]
    for view in corrected(replace(drifting_scene, train=masked), drifting_camera).train:
        assert (view.thermal[:10] == 0).all() and (view.thermal[10:] > 0).all()


def test_views_of_another_scene_are_refused(drifting_scene, drifting_camera):
    with pytest.raises(KeyError, match="is no training view"):
        drifting_camera.of_view(drifting_scene.test[0].name)
    stranger = replace(drifting_scene, train=[*drifting_scene.train, drifting_scene.test[0]])
    with pytest.raises(SceneError, match=drifting_scene.test[0].name):
        corrected(stranger, drifting_camera)
