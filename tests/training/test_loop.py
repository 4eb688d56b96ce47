import hashlib

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.priors import estimate_all
from tdgbench.splats.cpu import pool
from tdgbench.training.loop import NonFiniteError, train
from tdgbench.training.method import Context
from tests.conftest import config

METHODS = ["tdg", "msmg", "splat"]


def trained(scene, method_name: str, iterations: int = 60, seed: int = 0, **overrides):
    """A method trained for a while, with its log."""
    extra = [f"{k}={v}" for k, v in overrides.items()]
    cfg = config(
        f"method={method_name}", "prior=synthetic", "budget=demo", f"budget.iterations={iterations}",
        "budget.density.start=20", "budget.density.every=20", "budget.sh_every=25", *extra,
    )  # fmt: skip
    method = instantiate(cfg.method.method)
    priors = estimate_all(instantiate(cfg.prior.estimator), scene, None) if method.needs_prior else {}
    points = instantiate(cfg.init.points).points(scene)
    method.setup(Context(scene, points, priors, instantiate(cfg.budget), "auto", seed))
    return method, train(method, iterations)


def digest(method) -> str:
    content = hashlib.sha256()
    for model in method.models().values():
        for _, tensor in model.gaussians.items():
            content.update(tensor.detach().numpy().tobytes())
    return content.hexdigest()


@pytest.mark.parametrize("name", METHODS)
def test_training_makes_it_better(small_scene, name):
    method, log = trained(small_scene, name, 150)
    first, last = (np.mean([line.loss for line in lines]) for lines in (log.lines[:8], log.lines[-8:]))
    assert last < 0.75 * first  # each over a round of the training views
    assert log.lines[-1].psnr > log.lines[0].psnr + 3
    assert log.lines[-1].gaussians == sum(len(m) for m in method.models().values())
    render = method.render(small_scene.test[0].camera)
    assert render.image.shape == small_scene.test[0].thermal.shape and not render.image.requires_grad


@pytest.mark.parametrize("name", METHODS)
def test_same_seed_same_bytes(small_gray_scene, name):
    digests = []
    try:
        for threads in (1, 2, 2):
            pool.set_threads(threads)
            digests.append(digest(trained(small_gray_scene, name)[0]))
    finally:
        pool.set_threads(None)
    assert len(set(digests)) == 1
    assert digest(trained(small_gray_scene, name, seed=1)[0]) != digests[0]


def test_gray_scenes_train_one_channel(small_gray_scene):
    method, _ = trained(small_gray_scene, "splat", 2)
    assert method.models()["thermal"].gaussians.channels == 1


def test_sh_degree_rises(small_scene):
    method, _ = trained(small_scene, "splat", 24)
    assert method.model.degree == 0
    method, _ = trained(small_scene, "splat", 26)
    assert method.model.degree == 1


def test_a_nan_is_found_where_it_first_appears(small_scene):
    method, _ = trained(small_scene, "splat", 2)
    method.model.gaussians.sh[:, 0, 0] = torch.nan
    with pytest.raises(NonFiniteError, match="thermal render is not finite at iteration 1") as error:
        train(method, 5)
    assert error.value.iteration == 1


def test_a_nan_that_no_view_shows_is_found_too(small_scene):
    method, _ = trained(small_scene, "splat", 2)
    method.model.gaussians.means[3, 1] = torch.nan
    with pytest.raises(NonFiniteError, match="thermal means is not finite at iteration 1"):
        train(method, 5)
