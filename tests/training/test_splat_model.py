import dataclasses
import weakref

import pytest
import torch
from hydra.utils import instantiate
from torch.multiprocessing.reductions import StorageWeakRef

from tdgbench.splats.cpu.raster.passes import Blended
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.optimizer import BLACK
from tdgbench.training import splat_model as model_module
from tdgbench.training.losses import thermal_loss
from tdgbench.training.skips import Skips
from tdgbench.training.splat_model import SplatModel
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
        model.step(1)
        models.append(model)
    a, b = (m.state.values for m in models)
    models[0].optimizer.flush()
    # Adam's first step is a sign, which rounding may flip near zero; that is all there is for the turns of a sphere.
    turns = models[0].state.columns_of("quats")
    a[:, turns] = b[:, turns]
    far = ((a - b).abs() > 1e-4).float().mean()
    assert far < 0.01 and torch.equal(models[0].density.view_counts, models[1].density.view_counts)
    assert torch.allclose(models[0].density.grad_sum, models[1].density.grad_sum, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_what_is_not_covered_shows_the_background(small_scene, backend):
    """Renders, and gradients of a step, are those over black with the transmitted background added by torch."""
    view, found = small_scene.train[0], []
    background = torch.tensor([0.2, 0.5, 0.9])
    for behind in (background, None):
        model = make(small_scene, 3)
        model.backend, model.background = backend, behind
        model.density.rules = dataclasses.replace(model.density.rules, start=10)
        model.begin(1)
        render = model.render(view.camera)
        image = render.image if behind is not None else render.image + render.transmittance[..., None] * background
        (image - torch.from_numpy(view.thermal)).square().mean().backward()
        (seen,) = model._views
        gradients = seen.gradients.compute()
        model._views.clear()
        found.append((image.detach(), *gradients.rows()))
    assert (found[0][0] - model.render(view.camera).image).abs().max() > 0.1
    for a, b in zip(*found, strict=True):
        assert torch.allclose(a.double(), b.double(), rtol=1e-3, atol=1e-6)


def test_density_control_sees_the_training_view(small_scene):
    model, view = make(small_scene), small_scene.train[0]
    model.begin(1)
    render = model.render(view.camera)
    (render.image - torch.from_numpy(view.thermal[..., :1])).abs().sum().backward()
    assert model.density.view_counts.sum() > 0
    before = len(model)
    model.step(iteration=1)
    assert len(model) > before and model.density.view_counts.sum() == 0  # densified, and counting from zero


def test_a_round_has_the_memory_of_the_gradients(small_scene, monkeypatch):
    model, there, columns = make(small_scene), [], []
    model.begin(1)
    model.render(small_scene.train[0].camera).image.sum().backward()
    (view,) = model._views
    alive, update, observe = weakref.ref(view.gradients), model.density.update, model.density.observe
    del view

    def observed(views):
        columns.extend(view.gradients.columns for view in views)
        observe(views)

    monkeypatch.setattr(model.density, "update", lambda *args: there.append(alive()) or update(*args))
    monkeypatch.setattr(model.density, "observe", observed)
    before = len(model)
    model.step(iteration=1)
    assert there == [None] and len(model) != before and model.work.touched > 0
    assert columns == [0]  # no step follows, so that gradients of parameters are not computed


def test_looking_does_not_count(small_scene):
    model = make(small_scene)
    with torch.no_grad():
        model.render(small_scene.test[0].camera)
    model.step(iteration=1000)
    assert model.density.view_counts.sum() == 0 and model.optimizer.steps["means"] == 0


@torch.no_grad()
def test_after_its_end_a_model_renders_alike_without_the_memory_of_moments(small_scene):
    with torch.enable_grad():
        model, camera = one_pass(small_scene, 1, 30), small_scene.test[0].camera
    before = model.render(camera, depth=True)
    moments = [StorageWeakRef(tensor.untyped_storage()) for tensor in (model.state._first, model.state._second)]
    model.end()
    assert all(moment.expired() for moment in moments)
    after = model.render(camera, depth=True)
    for a, b in ((before.image, after.image), (before.depth, after.depth)):
        assert torch.allclose(a, b, atol=1e-5)  # deferred steps are applied in another order
    assert model.state.arrays().first.size == model.state.arrays().second.size == 0


RULES = (
    "sh_degree=2", "sh_every=40", "density.start=20", "density.every=25", "density.stop=240",
    "density.opacity_reset_every=110", "density.grad_threshold=5e-5", "iterations=1000",
)  # fmt: skip


def one_pass(scene, channels: int, iterations: int, unseen: bool = True) -> SplatModel:
    """A model after some iterations, with rounds, resets and rising degrees."""
    budget = instantiate(config("budget=demo", *(f"budget.{rule}" for rule in RULES)).budget)
    start = gaussians_from_points(scene.points.points, scene.points.colors, channels, budget.sh_degree)
    generator = torch.Generator().manual_seed(0)
    model = SplatModel(start, budget, scene.extent, "cpu", generator, Skips(unseen=unseen))
    for iteration in range(1, iterations + 1):
        take_step(model, scene.train[iteration % len(scene.train)], channels, iteration)
    return model


def take_step(model, view, channels: int, iteration: int) -> str | None:
    model.begin(iteration)
    render = model.render(view.camera, depth=iteration % 3 == 0)
    target = torch.from_numpy(view.thermal[..., :1]).expand(-1, -1, channels).contiguous()
    loss = thermal_loss(render.image, target, 0.2, 0.1, "written")
    (loss + (0.0 if render.depth is None else 1e-2 * render.depth.mean())).backward()
    return model.step(iteration)


def bytes_of(model: SplatModel) -> dict[str, bytes]:
    """All that training changes."""
    tensors = {name: getattr(model.state, name) for name in ("values", "first", "second", "bounds", "clocks")}
    tensors |= model.density.state_dict()
    return {name: tensor.numpy().tobytes() for name, tensor in tensors.items()}


@pytest.mark.parametrize(("channels", "unseen"), [(1, True), pytest.param(3, False, marks=pytest.mark.slow)])
def test_gradients_and_step_in_one_pass_are_those_in_two(small_scene, monkeypatch, channels, unseen):
    """The same bytes after 200 iterations with density control."""
    taken, take = [], Blended.step
    monkeypatch.setattr(Blended, "step", lambda *args: taken.append(1) or take(*args))
    together = one_pass(small_scene, channels, 200, unseen)
    render_state = model_module.render_state

    def computed_first(state, optimizer, camera, options, collect, backend):
        return render_state(state, optimizer, camera, options, lambda view: collect(view.compute()), backend)

    monkeypatch.setattr(model_module, "render_state", computed_first)
    count = len(taken)
    apart = one_pass(small_scene, channels, 200, unseen)
    assert count > 180 and len(taken) == count
    assert together.degree == 2 and together.work == apart.work and together.work.cloned + together.work.split > 0
    assert bytes_of(together) == bytes_of(apart)


def test_a_gradient_that_is_not_finite_is_named_alike(small_scene):
    """Whether the gradients are rows or pending."""
    found = []
    for computed in (False, True):
        model = one_pass(small_scene, 1, 3)
        model.begin(4)
        render = model.render(small_scene.train[0].camera)
        render.image.sum().backward()
        (view,) = model._views
        view.gradients.slots.values.fill(3e38)  # overflows where two are added
        if computed:
            view.gradients = view.gradients.compute()
        found.append(model.step(4))
    assert found[0] == found[1] is not None


@pytest.mark.parametrize(("every", "comes_back"), [(None, False), (2, True)])
def test_a_colour_below_black(small_scene, every, comes_back):
    """Renders clamp it, so that it has no gradient (3DGS): it stays, or is lifted to black and learns again."""
    words = ["budget=demo", "budget.density.start=1000", f"budget.lift_dark_every={every or 'null'}"]
    budget = instantiate(config(*words).budget)
    start = gaussians_from_points(small_scene.points.points, small_scene.points.colors, 1, budget.sh_degree)
    start.sh[:, 0] = -4.0
    model = SplatModel(start, budget, small_scene.extent, "auto", torch.Generator().manual_seed(0))
    for iteration in range(1, 7):
        model.begin(iteration)
        (1 - model.render(small_scene.train[0].camera).image).square().mean().backward()
        model.step(iteration)
    base = model.gaussians.sh[:, 0, 0]
    assert bool((base == -4.0).all()) is not comes_back
    assert bool((base > BLACK + 0.001).any()) is comes_back
