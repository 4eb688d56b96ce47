"""Absolute gradients of image means: against finite differences by pixel, between backends, and in density control."""

import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.backends import backend, load_backend, reference
from tdgbench.splats.view import AS_3DGS
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.helpers.training import ready_to_train, train
from tests.splats.backward_passes import COUNT, HEIGHT, WIDTH, backward_pass, cloud


def absgrad_of(name, channels, degree, mode):
    """Gradients (N, 2) of image means, and absolute ones, of a loss with random slopes."""
    kind = torch.float64 if name == "reference" else torch.float32
    leaves = [p.to(kind).requires_grad_() for p in random_gaussians(150, 4, degree, channels)]
    camera = (t.to(kind) for t in turned_camera(WIDTH, HEIGHT))
    image, alpha, meta = rasterization(
        *leaves, *camera, WIDTH, HEIGHT, sh_degree=degree, render_mode=mode, backend=name, absgrad=True
    )
    g = torch.Generator().manual_seed(0)
    sum((o * torch.randn(o.shape, generator=g, dtype=torch.float64).to(o)).sum() for o in (image, alpha)).backward()
    return meta["means2d"][0].grad.double(), meta["absgrad"][0].double()


@pytest.mark.parametrize(
    ("channels", "degree", "mode"), [(1, None, "RGB+D"), (3, 1, "RGB+D"), (1, 2, "RGB"), (6, None, "RGB")]
)
def test_the_core_agrees_with_the_reference(channels, degree, mode):
    _, found = absgrad_of("cpu", channels, degree, mode)
    signed, want = absgrad_of("reference", channels, degree, mode)
    assert (found - want).abs().max() < 1e-5 * want.max()
    assert (want >= signed.abs() - 1e-9).all() and want.sum() > 2 * signed.abs().sum()  # most of it cancels


def test_the_reference_agrees_with_finite_differences_by_pixel():
    g = torch.Generator().manual_seed(1)
    n, side, step = 4, 9, 1e-6
    means2d = side * torch.rand(n, 2, generator=g, dtype=torch.float64)
    conics = torch.tensor([[0.08, 0.02, 0.05]], dtype=torch.float64).repeat(n, 1)
    opacities, colors = torch.full((n,), 0.6, dtype=torch.float64), torch.rand(n, 2, generator=g, dtype=torch.float64)
    pixels = torch.cartesian_prod(torch.arange(side), torch.arange(side)).double() + 0.5
    slopes = torch.randn(len(pixels), 3, generator=g, dtype=torch.float64)

    def by_pixel(means, observe=None):
        light, transmittance = reference.blend(pixels, means, conics, opacities, colors, AS_3DGS, observe)
        return (light * slopes[:, :2]).sum(dim=1) + transmittance * slopes[:, 2]

    found = torch.zeros(n, 2, dtype=torch.float64)

    def observe(gradients):
        found.add_(gradients.abs().sum(dim=0))

    by_pixel(means2d.clone().requires_grad_(), observe).sum().backward()
    for i in range(n):
        for axis in range(2):
            moved = torch.zeros_like(means2d)
            moved[i, axis] = step
            change = (by_pixel(means2d + moved) - by_pixel(means2d - moved)).abs()
            change = change[change < 100 * step]  # alpha does not cross 1/255
            assert found[i, axis] == pytest.approx(change.sum().item() / (2 * step), rel=1e-5)


def test_a_hook_leaves_the_same_absolute_gradients():
    """Gradients then pass through torch; `image` has two more columns than without."""
    images = []
    for hook in (None, lambda gaussians, degree: gaussians.activated(degree)):
        gradients = backward_pass(cloud(1, 1), "cpu", 1, absgrad=True, hook=hook).gradients.compute()
        index, _, image = gradients.rows()
        images.append(torch.zeros(COUNT, 5).index_add_(0, index, image))
    seen = images[0][:, 2] > 0
    assert torch.allclose(images[0][seen], images[1][seen], rtol=1e-4, atol=1e-5)
    assert backward_pass(cloud(1, 1), "cpu", 1).gradients.compute().image.shape[1] == 3


def test_what_a_backend_cannot_give_is_an_error(monkeypatch):
    with pytest.raises(ValueError, match=r"up to 6 channels, and 6 channels and depth were requested; use backend=ref"):
        absgrad_of("cpu", 6, None, "RGB+D")

    class Without(backend.Backend):
        def render(self, gaussians, camera, options):
            return load_backend("reference").render(gaussians, camera, options._replace(absgrad=False))

    monkeypatch.setattr("tdgbench.splats.render.load_backend", lambda name: Without())
    backward_pass(cloud(1, 0), "reference", 0)
    with pytest.raises(ValueError, match="this backend gives no absolute gradients; choose backend=cpu"):
        backward_pass(cloud(1, 0), "reference", 0, absgrad=True)


def test_absolute_gradients_grow_a_training_the_same_way_on_every_backend(small_gray_scene):
    """Up to single Gaussians: Adam turns a difference of rounding in a small gradient into one of a step's size."""
    counts = {}
    for name, gradient in (("cpu", "absolute"), ("reference", "absolute"), ("cpu", "signed")):
        trainer = ready_to_train(
            small_gray_scene, "3dgs", 12, f"budget.density.gradient={gradient}", "budget.density.grad_threshold=1e-3",
            "budget.density.start=4", "budget.density.every=5", "budget.density.round_recovery=0", f"backend={name}",
        )  # fmt: skip
        train(trainer)
        counts[name, gradient] = trainer.method.model.report()
    absolute, signed = counts["cpu", "absolute"], counts["cpu", "signed"]
    assert absolute == pytest.approx(counts["reference", "absolute"], rel=0.01)
    assert absolute["cloned"] + absolute["split"] > 1.5 * (signed["cloned"] + signed["split"])
