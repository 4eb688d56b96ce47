import json
from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes import SceneError, TemperatureRange, View
from tdgbench.thermal import IDEAL, ImageResponse, correct_values, corrected, read_response
from tdgbench.thermal.maps import TERMS, evaluate
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


def test_an_ideal_camera_leaves_every_byte(drifting_scene, drifting_camera):
    """Also where rounding would put values of 0 and 1 beyond the range."""
    ideal = replace(
        drifting_camera, offsets=np.zeros(12), gains=np.ones(12), vignette=0 * drifting_camera.vignette,
        expected=dict.fromkeys(drifting_camera.expected, 0.0), reference=17.3,
    )  # fmt: skip
    found = corrected(replace(drifting_scene, temperature=TemperatureRange(-9.39, 40.37)), ideal)
    assert found.response == IDEAL and found.scene.fingerprint == drifting_scene.fingerprint
    assert found.scene.train == drifting_scene.train and "stay as they are" in found.scene.notes[-1 - len(ideal.notes)]


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


def random_camera(camera, seed):
    """A camera with a random response and an expected offset of each test view."""
    rng = np.random.default_rng(seed)
    return replace(
        camera, offsets=rng.normal(0, 2, 12), gains=rng.uniform(0.8, 1.2, 12), vignette=rng.normal(0, 0.5, len(TERMS)),
        expected={name: float(rng.normal()) for name in camera.expected}, reference=float(rng.uniform(10, 30)),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(2))
def test_what_was_corrected_is_shown_again(drifting_scene, drifting_camera, seed):
    scene, response = corrected(drifting_scene, random_camera(drifting_camera, seed))
    assert (response.low, response.high) != (0, 1) and response.vignette
    for before, after in zip(drifting_scene.train, scene.train, strict=True):
        shown = response.shown(after.thermal, after.name)
        assert shown.dtype == np.float32 and np.abs(shown - before.thermal).max() < 2e-6


def test_a_scene_without_temperatures_has_a_response_in_image_values(drifting_scene, drifting_camera):
    given = replace(drifting_scene, temperature=None)
    camera = random_camera(drifting_camera, 0)
    small = replace(
        camera, unit="image", reference=0.4, offsets=camera.offsets / 50, vignette=camera.vignette / 50,
        expected={},
    )  # fmt: skip
    scene, response = corrected(given, small)
    assert scene.temperature is None and response.offsets[small.views[0]] == pytest.approx(small.offsets[0], abs=1e-6)
    view = scene.train[0]
    assert np.abs(response.shown(view.thermal, view.name) - drifting_scene.train[0].thermal).max() < 2e-6


def test_a_test_view_has_what_all_views_share_and_the_offset_that_is_expected(drifting_scene, drifting_camera):
    scene, response = corrected(drifting_scene, drifting_camera)
    name, given = scene.test[0].name, drifting_scene.temperature
    render = np.random.default_rng(0).random((72, 96, 1)).astype(np.float32)
    degC, shown = celsius_of(render, scene.temperature), celsius_of(response.shown(render, name), given)
    added = drifting_camera.expected[name] + evaluate(drifting_camera.vignette, 96, 72)
    assert np.abs(shown - degC - added[..., None]).max() < 1e-4 and drifting_camera.expected[name] != 0
    assert celsius_of(response.temperatures(render), given) == pytest.approx(degC, abs=1e-4)


def test_the_offset_of_a_test_view_is_near_the_true_one(drifting_scene, drifting_camera, clean_scene):
    """Nothing of it was read; without it, its values are wrong by degrees. The gains of 5 % are not known."""
    _, response = corrected(drifting_scene, drifting_camera)
    span = drifting_scene.temperature.max - drifting_scene.temperature.min
    vignette = evaluate(drifting_camera.vignette, 96, 72)
    clean = {view.name: celsius(view, clean_scene) for view in clean_scene.test}
    left = {}
    for view in drifting_scene.test:
        left[view.name] = float(np.mean(celsius(view, drifting_scene) - vignette - clean[view.name]))
    assert set(left) == set(response.offsets) - set(drifting_camera.views)
    offsets = np.array([[true, span * response.offsets[name]] for name, true in left.items()])
    assert np.std(offsets[:, 0] - offsets[:, 1]) < 0.6 * np.std(offsets[:, 0])


def celsius_of(image: np.ndarray, span: TemperatureRange) -> np.ndarray:
    return span.min + (span.max - span.min) * image.astype(np.float64)


def test_a_record_holds_all_of_a_response(drifting_scene, drifting_camera):
    for camera in (drifting_camera, random_camera(drifting_camera, 1)):
        response = corrected(drifting_scene, camera).response
        assert read_response(json.loads(json.dumps(response.as_json()))) == response
    assert read_response(None) == ImageResponse() == read_response(ImageResponse().as_json())


def test_an_ideal_camera_shows_renders_as_they_are():
    render = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32)
    assert ImageResponse().shown(render, "any") is render and ImageResponse().is_ideal
    wide = ImageResponse(low=-0.5, high=1.5)
    assert wide.is_ideal and wide.shown(render, "any") == pytest.approx(2 * render - 0.5)


@pytest.mark.parametrize(
    "stated",
    [
        5, [], [1, 2], "offsets", {"offsets": [1.0]}, {"offsets": {"view000": "much"}}, {"gains": {"view000": None}},
        {"vignette": "none"}, {"low": []}, {"high": "NaN."}, {"offset": {"view000": 1.0}},
        {"vignette": [0.1]}, {"low": 1.0, "high": 0.0}, {"gains": {"view000": float("nan")}},
    ],
    ids=str,
)  # fmt: skip
def test_a_response_that_is_stated_wrongly_is_refused(stated):
    with pytest.raises(ValueError, match=r"\w"):
        read_response(stated)
