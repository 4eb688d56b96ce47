"""MMOne: two renders of one geometry, the gradients that density control reads, and its rules in training."""

from dataclasses import replace

import pytest
import torch

from methods.mmone import AS_RGB, OPACITY_RGB, SH_RGB
from tdgbench.splats.backends import load_backend
from tdgbench.splats.view import Pinhole, RenderOptions
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.losses import photometric, thermal_loss
from tests.helpers.masks import masked_scene
from tests.helpers.training import OFTEN, digest, ready_to_train, take_gradients, train
from tests.parity.originals import relative

OFF = 0.003
NEVER = "budget.density.opacity_reset_every=100000"


def opacities(model) -> tuple[torch.Tensor, torch.Tensor]:
    """Return those of RGB and of thermal images (N,)."""
    return model.gaussians.extra_fields[OPACITY_RGB].sigmoid().squeeze(1), model.gaussians.opacities


def test_both_modalities_start_alike(small_scene):
    model = ready_to_train(small_scene, "mmone", 10).method.model
    rgb, thermal = opacities(model)
    assert torch.equal(rgb, thermal) and torch.allclose(rgb, torch.tensor(0.1))
    assert torch.equal(model.gaussians.extra_fields[SH_RGB], model.gaussians.sh)


def test_loss_and_gradients_are_those_of_the_reference(small_gray_scene):
    """In double, with renders beyond 1: of every field, and of each modality's means on the image."""
    trainer = ready_to_train(small_gray_scene, "mmone", 10)
    method, model = trainer.method, trainer.method.model
    model.degree = 1
    draw = torch.Generator().manual_seed(0)
    for field in (model.gaussians.sh, model.gaussians.extra_fields[SH_RGB]):
        field[:, :4] += 4 + 1.5 * torch.randn(field[:, :4].shape, generator=draw)
    for field in (model.gaussians.opacity_logits, model.gaussians.extra_fields[OPACITY_RGB]):
        field += 2 + 2 * torch.randn(field.shape, generator=draw)
    for field in (model.gaussians.log_scales, model.gaussians.quats):
        field += 0.3 * torch.randn(field.shape, generator=draw)
    model.state.refresh_bounds()
    leaves = model.copy().map(lambda tensor: tensor.double().requires_grad_())
    view = method.views.views[0]
    method.views.next = lambda: view
    step = trainer.stage.step(1)
    step.loss.backward()
    model.density.observe(model._views)
    camera = Pinhole.of(view.camera).to(leaves.means)
    options = RenderOptions(blending=model.blending)
    both = {"rgb": AS_RGB(leaves, 1), "thermal": leaves.activated(1)}
    renders = {name: load_backend("reference").render(given, camera, options) for name, given in both.items()}
    assert min(render.image.max() for render in renders.values()) > 1
    rgb, thermal = (render.image.clamp(0, 1) for render in renders.values())
    target, valid = THERMAL.tensors_of(view, rgb.device)
    loss = 0.5 * photometric(rgb, RGB.tensors_of(view, rgb.device)[0].double(), 0.2)
    loss = loss + 0.5 * thermal_loss(thermal, target.double(), 0.2, 0.6, "released", valid)
    loss.backward()
    assert step.loss.item() == pytest.approx(loss.item(), rel=1e-5)
    half = torch.tensor([view.camera.width / 2, view.camera.height / 2]).double()
    pulls = [render.projection.means2d.grad * half for render in renders.values()]
    assert relative(model.density.rgb_sum, pulls[0]) < 1e-5
    assert relative(model.density.thermal_sum, pulls[1]) < 1e-5
    assert relative(model.density.grad_sum, (pulls[0] + pulls[1]).norm(dim=1)) < 1e-5
    visible = renders["thermal"].projection.radii > 0
    assert torch.equal(model.density.view_counts, visible.float())  # two renders are one view
    index, rows, _ = take_gradients(model).rows()
    dense = torch.zeros_like(model.state.values)
    dense.index_add_(0, index, rows[:, : dense.shape[1]])  # gradients fill whole cache lines
    for (name, ours), (_, theirs) in zip(model.state.split(dense).items(), leaves.items(), strict=True):
        assert relative(ours.reshape(theirs.shape), theirs.grad) < 1e-5, name


def test_a_switched_off_opacity_stays_off(small_gray_scene):
    """Without gradient, and without moments that go on moving it."""
    often = ("budget.density.start=5", "budget.density.every=10", "budget.density.stop=12", NEVER)
    trainer = ready_to_train(small_gray_scene, "mmone_described", 40, *often, "method.method.decompose_threshold=0")
    train(trainer)
    rgb, thermal = opacities(trainer.method.model)
    for off in (rgb, thermal):
        assert int((off - OFF).abs().lt(1e-6).sum()) > 50


def test_growth_ends_at_the_limit(small_gray_scene):
    """Modalities pull half of the Gaussians apart, which are copied; the others are cloned as far as the limit."""
    model = ready_to_train(small_gray_scene, "mmone", 1000).method.model
    model.gaussians.opacity_logits[:] = 1.0
    model.gaussians.extra_fields[OPACITY_RGB][:] = 1.0
    model.gaussians.log_scales[:] = -12.0
    model.density.view_counts[:] = 2
    model.density.grad_sum[:] = 2 * 3e-4
    count = len(model)
    model.density.rgb_sum[: count // 2, 0] = 2 * 3e-4
    model.density.rules = replace(model.density.rules, max_gaussians=count + count // 2 + 10)
    iteration = next(i for i in range(1, 1000) if model.density.is_round(i))
    change = model.density.update(model.optimizer, iteration, torch.Generator().manual_seed(0))
    assert change.cloned == count // 2 + 10 and len(model) == count + count // 2 + 10
    assert int((opacities(model)[0] < 0.01).sum()) == count // 2


def test_a_reset_lowers_both_opacities_and_neither_takes_a_step(small_gray_scene):
    resets = ("budget.density.opacity_reset_every=7", "budget.density.reset_recovery=0")
    trainer = ready_to_train(small_gray_scene, "mmone", 30, *OFTEN, *resets)
    seen = []

    def look(log):
        if log.iterations == 7:
            seen.extend(of.clone() for of in opacities(trainer.method.model))

    train(trainer, after_iteration=look)
    assert all(float(of.max()) == pytest.approx(0.01, rel=1e-5) for of in seen)


def test_another_density_control_is_refused(small_gray_scene):
    with pytest.raises(ValueError, match="leave out \\+density"):
        ready_to_train(small_gray_scene, "mmone", 3, "+density=mcmc")
    with pytest.raises(ValueError, match="leave out budget\\.density\\.gradient=absolute"):
        ready_to_train(small_gray_scene, "mmone", 3, "budget.density.gradient=absolute")


def test_nothing_depends_on_what_is_under_the_mask(small_gray_scene):
    noise, nan = (
        ready_to_train(masked_scene(small_gray_scene, kind), "mmone", 30, *OFTEN) for kind in ("noise", "nan")
    )
    for trainer in (noise, nan):
        train(trainer)
    assert digest(noise) == digest(nan)
