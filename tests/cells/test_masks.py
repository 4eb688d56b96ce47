"""Masked pixels: nothing of a cell depends on what its images hold there, and the record counts them."""

from dataclasses import replace

import numpy as np
import pytest
from hydra.utils import instantiate

from tdgbench.bench.scores import render_views, score_training_views, write_renders
from tdgbench.cells.ground_truth import masked_in_words, masked_share
from tdgbench.priors import PriorError
from tdgbench.scenes import SceneError
from tdgbench.training.loop import train
from tests.helpers.configs import config
from tests.helpers.masks import masked_scene, with_garbage
from tests.helpers.training import digest, ready_to_train

OFTEN = ("budget.density.start=20", "budget.density.every=20", "budget.sh_every=25")


def all_of(scene, method: str, folder, *overrides: str):
    """Model, log, scores and written pictures of a short training."""
    trained = ready_to_train(scene, method, 45, *OFTEN, *overrides)
    log = train(trained)
    scorer = instantiate(config("metrics.lpips.download=false").metrics)
    renders = render_views(trained, scene.test)
    folder.mkdir()
    write_renders(renders, scene.test, folder)
    pictures = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.png"))}
    lines = [(line.loss, line.psnr, line.gaussians, line.terms) for line in log.lines]
    scores = scorer.score(scene, renders), score_training_views(trained, scene, scorer)
    priors = {name: prior.values.tobytes() for name, prior in trained.whole_context.priors.items()}
    return {"model": digest(trained), "log": lines, "scores": scores, "pictures": pictures, "priors": priors}


@pytest.mark.parametrize(
    ("scene_of", "method", "overrides"),
    [
        ("small_scene", "tdg", ("prior=sfm_points",)),
        ("small_scene", "msmg", ()),
        ("small_gray_scene", "tdg_released", ()),
        ("small_gray_scene", "3dgs", ()),
    ],
)
def test_nothing_depends_on_what_is_under_the_mask(scene_of, method, overrides, request, tmp_path):
    scene = request.getfixturevalue(scene_of)
    noise, nan, whole = (tmp_path / name for name in ("noise", "nan", "whole"))
    found = all_of(masked_scene(scene, "noise"), method, noise, *overrides)
    for part, content in all_of(masked_scene(scene, "nan"), method, nan, *overrides).items():
        assert content == found[part], part
    assert any(name.startswith("masks/") for name in found["pictures"])
    unmasked = all_of(scene, method, whole, *overrides)
    assert unmasked["model"] != found["model"] and unmasked["scores"] != found["scores"]


def test_a_mask_of_valid_pixels_alone_is_none(small_gray_scene, tmp_path):
    """Same bytes as without a mask."""
    everything = np.ones((36, 48), bool)
    views = {part: [with_garbage(v, everything, np.nan) for v in getattr(small_gray_scene, part)]
             for part in ("train", "test")}  # fmt: skip
    scene = replace(small_gray_scene, **views)
    assert scene.train[0].valid is None and masked_share(scene.train) == 0.0
    assert all_of(scene, "tdg", tmp_path / "one") == all_of(small_gray_scene, "tdg", tmp_path / "other")


def test_the_thermal_model_gets_no_gradient_from_masked_pixels(small_gray_scene):
    scene = masked_scene(small_gray_scene)
    trainer = ready_to_train(replace(scene, train=scene.train[1:]), "tdg", 60)
    for iteration in range(1, 5):
        for part in trainer.parts.values():
            part.begin(iteration)
        step = trainer.method.step(iteration)
        gradients = []
        step.render.image.register_hook(gradients.append)
        step.render.depth.register_hook(gradients.append)
        step.loss.backward()
        image, depth = gradients if gradients[0].ndim == 3 else gradients[::-1]
        assert image[step.valid].any() and not image[~step.valid].any()
        assert depth[step.valid].any() and not depth[~step.valid].any()


def test_a_training_view_without_a_valid_pixel_is_named(small_gray_scene):
    nothing = with_garbage(small_gray_scene.train[2], np.zeros((36, 48), bool), np.nan)
    scene = replace(small_gray_scene, train=[*small_gray_scene.train[:2], nothing])
    with pytest.raises(SceneError, match=rf"training view {nothing.name} of turntable has no valid pixel"):
        ready_to_train(scene, "3dgs", 3)


def test_a_prior_that_is_known_under_the_mask_alone_is_named(small_gray_scene, monkeypatch):
    from tdgbench.bench import setup

    scene = masked_scene(small_gray_scene)
    view = scene.train[1]
    estimate = setup.estimate_all

    def under_the_mask(*args):
        priors, made = estimate(*args)
        values = np.where(view.valid, np.nan, priors[view.name].values).astype(np.float32)
        return {**priors, view.name: replace(priors[view.name], values=values)}, made

    monkeypatch.setattr(setup, "estimate_all", under_the_mask)
    with pytest.raises(PriorError, match=f"prior of view {view.name} is known at none of the view's valid pixels"):
        ready_to_train(scene, "tdg", 3)


def test_shares_and_words(small_gray_scene):
    scene = masked_scene(small_gray_scene)
    masked = [0 if view.valid is None else (~view.valid).sum() for view in scene.train]
    assert masked_share(scene.train) == sum(masked) / (36 * 48 * len(scene.train)) > 0.1
    assert masked_share([]) == 0.0 and masked_in_words({}) == ""
    assert masked_in_words({"train": 0.0, "test": 0.25}).startswith(
        "0.0 % of the training and 25.0 % of the test pixels"
    )
