from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes import SceneError, View
from tdgbench.thermal import correct_values, corrected
from tests.helpers.layouts import celsius


def worst(scene, clean, views):
    """Largest RMS difference in °C of views from the clean ones, whose mean over all is that of the scene."""
    by_name = {view.name: celsius(view, clean) for view in clean.views}
    differences = [celsius(view, scene) - by_name[view.name] for view in views]
    return max(np.sqrt(np.mean(np.square(one - np.mean(differences)))) for one in differences)


@pytest.fixture(scope="module")
def corrected_scene(drifting_scene, drifting_camera):
    return corrected(drifting_scene, drifting_camera).scene


@pytest.fixture(scope="module")
def wide_camera(drifting_camera):
    """One with offsets so large that the corrected values leave the scene's range."""
    return replace(drifting_camera, offsets=drifting_camera.offsets + np.linspace(-12, 12, 12))


def test_corrected_training_views_are_as_those_of_an_ideal_camera(drifting_scene, corrected_scene, clean_scene):
    assert worst(drifting_scene, clean_scene, drifting_scene.train) > 2
    assert worst(corrected_scene, clean_scene, corrected_scene.train) < 0.25  # gains of mean 1 scale the scene by 0.5 %
    assert corrected_scene.points is drifting_scene.points


def test_nothing_is_clipped(drifting_scene, wide_camera):
    """The range grows to that of the corrected values, which all come back, and no further."""
    scene = corrected(drifting_scene, wide_camera).scene
    span, before = scene.temperature, drifting_scene.temperature
    assert span.min < before.min and span.max > before.max
    for view, given in zip(scene.train, drifting_scene.train, strict=True):
        ideal = correct_values(celsius(given, drifting_scene).astype(np.float64), view.name, wide_camera)
        assert np.abs(celsius(view, scene) - ideal).max() < 1e-4
    values = np.stack([view.thermal for view in scene.train])
    assert 0 <= values.min() < 2e-3 and 0.998 < values.max() <= 1


def test_the_range_is_stated(drifting_scene, wide_camera):
    scene, response = corrected(drifting_scene, wide_camera)
    given, span = drifting_scene.temperature, scene.temperature
    said = next(note for note in scene.notes if "need a range" in note)
    assert f"{span.min:.4g} to {span.max:.4g} °C" in said and "scores are of the given range" in said
    ends = given.min + (given.max - given.min) * np.array([response.low, response.high])
    assert ends == pytest.approx([span.min, span.max])


def test_test_views_are_as_they_are(drifting_scene, corrected_scene):
    for before, after in zip(drifting_scene.test, corrected_scene.test, strict=True):
        assert after is before


def test_nothing_made_from_the_images_before_is_taken_for_the_corrected(drifting_scene, drifting_camera):
    cameras = [drifting_camera, replace(drifting_camera, offsets=drifting_camera.offsets + 1e-3)]
    prints = {corrected(drifting_scene, camera).scene.fingerprint for camera in cameras}
    assert len(prints | {drifting_scene.fingerprint}) == 3
    assert corrected(drifting_scene, drifting_camera).scene.fingerprint in prints


def test_masked_pixels_stay_masked_and_need_no_range(drifting_scene, drifting_camera):
    valid = np.ones((72, 96), bool)
    valid[:10] = False

    def masked(view: View) -> View:
        image = view.thermal.copy()
        image[:10] = 50.0  # no temperature of the scene
        return replace(view, load_thermal=lambda: image, load_valid=lambda: valid)

    given = replace(drifting_scene, train=[masked(view) for view in drifting_scene.train])
    scene, response = corrected(given, drifting_camera)
    assert response.high < 2
    for view in scene.train:
        assert (view.thermal[:10] == 0).all() and (view.thermal[10:] >= 0).all() and view.thermal[10:].max() > 0


def test_views_of_another_scene_are_refused(drifting_scene, drifting_camera):
    with pytest.raises(KeyError, match="is unknown to the thermal camera"):
        drifting_camera.of_view("view999")
    stranger = replace(drifting_scene, train=[*drifting_scene.train, drifting_scene.test[0]])
    with pytest.raises(SceneError, match=drifting_scene.test[0].name):
        corrected(stranger, drifting_camera)
