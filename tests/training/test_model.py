import dataclasses

import torch
from hydra.utils import instantiate

from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.training.model import SplatModel
from tests.helpers.configs import config


def make(scene, channels=1):
    budget = instantiate(config("budget=demo", "budget.density.start=0", "budget.density.every=1").budget)
    cloud = scene.points
    start = gaussians_from_points(cloud.points, cloud.colors, channels, budget.sh_degree)
    return SplatModel(start, budget, scene.extent, "auto", torch.Generator().manual_seed(0))


def test_render_with_and_without_depth(small_scene):
    model, camera = make(small_scene, 3), small_scene.train[0].camera
    flat, deep = model.render(camera), model.render(camera, depth=True)
    assert flat.depth is None and torch.equal(flat.image, deep.image) and deep.depth.shape == (36, 48)
    assert torch.equal(flat.alpha, deep.alpha) and flat.image.shape == (36, 48, 3)


def test_backends_train_the_same(small_scene):
    """A step through autograd and the float32 reference is the step past it."""
    view, models = small_scene.train[0], []
    for backend in ("cpu", "reference"):
        model = make(small_scene)
        model.backend = backend
        model.begin(1)
        render = model.render(view.camera, depth=True)
        ((render.image - torch.from_numpy(view.thermal[..., :1])).abs().mean() + render.depth.mean()).backward()
        model.density.rules = dataclasses.replace(model.density.rules, start=10)
        model.finish(1)
        models.append(model)
    a, b = (m.state.values for m in models)
    models[0].optimizer.flush()
    # Adam's first step is a sign, which rounding may flip near zero; that is all there is for the turns of a sphere.
    turns = models[0].state.column_of("quats")
    a[:, turns] = b[:, turns]
    far = ((a - b).abs() > 1e-4).float().mean()
    assert far < 0.01 and torch.equal(models[0].density.view_counts, models[1].density.view_counts)
    assert torch.allclose(models[0].density.grad_sum, models[1].density.grad_sum, rtol=1e-3, atol=1e-7)


def test_density_control_sees_the_training_view(small_scene):
    model, view = make(small_scene), small_scene.train[0]
    model.begin(1)
    render = model.render(view.camera)
    (render.image - torch.from_numpy(view.thermal[..., :1])).abs().sum().backward()
    assert model.density.view_counts.sum() > 0
    before = len(model)
    model.finish(iteration=1)
    assert len(model) > before and model.density.view_counts.sum() == 0  # densified, and counting from zero


def test_looking_does_not_count(small_scene):
    model = make(small_scene)
    with torch.no_grad():
        model.render(small_scene.test[0].camera)
    model.finish(iteration=1000)
    assert model.density.view_counts.sum() == 0 and model.optimizer.steps["means"] == 0
