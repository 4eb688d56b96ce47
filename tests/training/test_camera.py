from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.bench import response
from tdgbench.scoring.metrics.psnr import psnr
from tdgbench.thermal import Unknown
from tdgbench.thermal.polynomials import evaluate
from tdgbench.training.camera import CameraOptions, IdealCamera, RefinedCamera, Refinement, camera_of
from tdgbench.training.loop import stopping_of, train
from tests.helpers.drift import drift, with_response
from tests.helpers.training import digest, ready_to_train

RULES = Refinement(offset_rate=0.02, gain_rate=0.02, vignette_rate=0.0005, offsets_alone=0, pace=30, decay=0.01)
REFINED = CameraOptions(refine=RULES)


def refined(scene, held=(), options=REFINED) -> RefinedCamera:
    camera = camera_of(scene, options, list(held))
    assert isinstance(camera, RefinedCamera)
    return camera


def vignette_of(camera: RefinedCamera) -> np.ndarray:
    return evaluate(camera.vignette.values[0], 48, 36)


def fit_to(camera: RefinedCamera, scene, truth, iterations: int) -> None:
    """Train the camera alone, on renders that are true: the least squares of the views of `scene`."""
    order = np.random.default_rng(0)
    for _ in range(iterations):
        index = order.integers(len(scene.train))
        image = torch.from_numpy(truth.train[index].thermal).requires_grad_()
        difference = camera.show(scene.train[index], image) - torch.from_numpy(scene.train[index].thermal)
        difference.square().mean().backward()
        camera.step()


def test_a_camera_alone_recovers_the_truth_in_its_gauge(small_gray_scene):
    count = len(small_gray_scene.train)
    offsets, gains = drift(count, 0.1), 1 + drift(count, 0.03, seed=1)
    scene = with_response(small_gray_scene, offsets, gains, bowl=0.01)
    camera = refined(scene)
    fit_to(camera, scene, small_gray_scene, 1000)
    at_reference = offsets + (gains - 1) * (camera.reference - 0.5)
    assert camera.offsets == pytest.approx(at_reference - at_reference.mean(), abs=0.005)
    assert camera.gains == pytest.approx(gains, abs=0.01)
    truth = with_response(small_gray_scene, 0 * offsets, np.ones(count), bowl=0.01).train[0].thermal
    vignette = (truth - small_gray_scene.train[0].thermal)[..., 0]
    assert vignette_of(camera) == pytest.approx(vignette, abs=0.005)


def test_gains_and_vignette_wait_until_offsets_are_learned(small_gray_scene):
    scene = with_response(small_gray_scene, drift(8, 0.1), 1 + drift(8, 0.03, seed=1), bowl=0.02)
    camera = refined(scene, options=CameraOptions(refine=replace(RULES, offsets_alone=3)))
    fit_to(camera, scene, small_gray_scene, 8 * 3)
    assert camera.offsets.any() and not vignette_of(camera).any() and (camera.gains == 1).all()
    fit_to(camera, scene, small_gray_scene, 8 * 3)
    assert vignette_of(camera).any() and (camera.gains != 1).any()


def test_the_gauge_is_kept_after_every_step(small_gray_scene):
    scene = with_response(small_gray_scene, 0.3 + drift(len(small_gray_scene.train), 0.1), np.full(8, 1.2))
    held = scene.train[2:3]
    camera = refined(scene, held)
    first = np.array([view not in held for view in scene.train])
    for steps in (1, 7, 30):
        fit_to(camera, scene, small_gray_scene, steps)
        assert camera.offsets[first].mean() == pytest.approx(0.0, abs=1e-12)
        assert camera.gains[first].mean() == pytest.approx(1.0, abs=1e-12)
        for index in range(8):
            shown = camera._response(index)
            added = shown.added(torch.zeros(23, 31, 1, dtype=torch.float64)).numpy()
            assert added.mean() == pytest.approx(shown.offset + (1 - shown.gain) * camera.reference, abs=1e-9)
    assert np.abs(camera.offsets).max() > 0.01


def test_a_view_that_was_held_out_has_its_best_fit_and_starts_from_it(small_gray_scene):
    scene = with_response(small_gray_scene, np.full(8, 0.2), np.full(8, 0.9))
    camera, view, image = refined(scene, scene.train[:1]), scene.train[0], small_gray_scene.train[0].thermal
    seen = camera.compare(view, torch.from_numpy(image))
    assert seen.numpy() == pytest.approx(view.thermal, abs=1e-5)
    assert (camera.offsets[0], camera.gains[0]) == (0.0, 1.0)  # looking changes nothing
    camera.show(view, torch.from_numpy(image))
    assert camera.gains[0] == pytest.approx(0.9, abs=1e-4)
    other = scene.train[1]  # trained on from the start: nothing is fitted to it before its first step
    camera.show(other, torch.from_numpy(image))
    assert (camera.offsets[1], camera.gains[1]) == (0.0, 1.0)


def test_an_ideal_camera_shows_images_as_they_are(small_gray_scene):
    camera, image = camera_of(small_gray_scene, CameraOptions(), []), torch.rand(36, 48, 1)
    assert type(camera) is IdealCamera and camera.state_dict() == {} and camera.reason == ""
    assert camera.show(small_gray_scene.train[0], image) is image
    assert camera.compare(small_gray_scene.train[0], image) is image


def test_pseudo_colour_is_trained_with_an_ideal_camera_and_says_why(small_scene):
    camera = camera_of(small_scene, REFINED, [])
    assert type(camera) is IdealCamera and "pseudo-colour" in camera.reason
    training = ready_to_train(small_scene, "splat", 20, "camera=refined")
    train(training.method, 20)
    ideal = ready_to_train(small_scene, "splat", 20)
    train(ideal.method, 20)
    assert digest(training.method) == digest(ideal.method)


def test_a_method_that_does_not_use_the_camera_is_an_error(small_gray_scene):
    scene = with_response(small_gray_scene, drift(8, 0.1), np.ones(8))
    method, _ = ready_to_train(scene, "splat", 20, "camera=refined")
    method.model.show = lambda view: method.model.render(view.camera)
    with pytest.raises(RuntimeError, match=r"model\.show\(view\)"):
        train(method, 20)


@pytest.mark.parametrize("name", ["splat", "thermal", "tdg", "msmg"])
def test_every_method_refines_it(small_gray_scene, name):
    scene = with_response(small_gray_scene, drift(8, 0.1), np.ones(8))
    method, context = ready_to_train(scene, name, 60, "camera=refined")
    train(method, 60)
    assert np.corrcoef(context.camera.offsets, drift(8, 0.1))[0, 1] > 0.8
    assert context.camera.views.steps.sum() == 59  # the last iteration only measures
    models = method.models()
    assert models["thermal"].camera is context.camera
    assert "rgb" not in models or type(models["rgb"].camera) is IdealCamera


def test_gray_images_of_three_channels(small_gray_scene):
    def colored(view):
        return replace(view, load_thermal=lambda: np.repeat(view.thermal, 3, axis=2))

    three = [[colored(view) for view in views] for views in (small_gray_scene.train, small_gray_scene.test)]
    scene = with_response(
        replace(small_gray_scene, train=three[0], test=three[1], channels=3), drift(8, 0.1), np.ones(8)
    )
    method, context = ready_to_train(scene, "splat", 60, "camera=refined")
    train(method, 60)
    assert np.corrcoef(context.camera.offsets, drift(8, 0.1))[0, 1] > 0.8


def test_held_out_views_and_growth_look_through_the_camera(small_gray_scene):
    """With a lean budget on a drifting scene, held-out views are about as good as without drift."""
    lean = ("budget=lean", "budget.iterations=60", "budget.settling.fewest=1", "budget.density.start=10",
            "budget.density.every=10", "budget.pixels.smallest_side=8", "camera=refined")  # fmt: skip
    scene = with_response(small_gray_scene, np.full(8, 0.3), np.ones(8))
    method, context = ready_to_train(scene, "splat", 60, *lean)
    settling = stopping_of(method, context)
    held = context.curriculum.held
    assert held and method.model.significance.camera is context.camera
    image = method.render(held[0].camera).image.numpy()
    before = settling._held_out_psnrs()[0]
    assert before == pytest.approx(-10 * np.log10(np.mean((context.camera.compare(
        held[0], torch.from_numpy(image)).numpy() - held[0].thermal) ** 2)), abs=1e-3)  # fmt: skip
    assert before > psnr(image.clip(0, 1), held[0].thermal) + 1
    train(method, 60, stopping=settling)
    index = context.camera.names.index(held[0].name)
    assert context.camera.views.steps[index] > 0  # once it has settled, it is trained on as well


def psnrs(method, views, score):
    images = [method.render(view.camera).image.numpy().clip(0, 1) for view in views]
    return float(np.mean([score(image, view.thermal) for image, view in zip(images, views, strict=True)]))


@pytest.mark.slow
def test_drift_is_learned_with_the_scene(small_gray_scene, monkeypatch):
    """Without the estimate before training, which this scene has too few points for."""
    monkeypatch.setattr(response, "estimate_camera", lambda scene: Unknown("not asked"))
    offsets = drift(8, 0.08)
    scene = with_response(small_gray_scene, offsets, np.ones(8))
    method, context = ready_to_train(scene, "splat", 1200, "camera=refined", "camera.refine.terms=[offsets]")
    train(method, 1200)
    assert np.sqrt(np.mean((context.camera.offsets - offsets) ** 2)) < 0.15 * 0.08


@pytest.mark.parametrize("terms", [["offsets"], ["vignette"], ["gains", "offsets"]])
def test_only_the_given_terms_are_learned(small_gray_scene, terms):
    scene = with_response(small_gray_scene, drift(8, 0.1), 1 + drift(8, 0.03, seed=1), bowl=0.01)
    options = CameraOptions(refine=replace(RULES, terms=terms))
    camera = camera_of(scene, options, scene.train[:1])
    fit_to(camera, scene, small_gray_scene, 60)
    assert (np.abs(camera.offsets).max() > 0.01) == ("offsets" in terms)
    assert (np.abs(camera.gains - 1).max() > 0.001) == ("gains" in terms)
    assert (np.abs(vignette_of(camera)).max() > 0.001) == ("vignette" in terms)
