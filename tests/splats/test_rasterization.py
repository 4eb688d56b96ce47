"""Every backend against the float64 reference, in value and gradient; the reference against finite differences."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tdgbench.splats import rasterization
from tdgbench.splats.backends import backend_names, load_backend
from tdgbench.splats.cpu import jit, pool
from tdgbench.splats.view import AS_3DGS, Blending
from tests.helpers.backends import need
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.helpers.paths import ROOT

FAST_BACKENDS = [
    pytest.param(name, marks=[pytest.mark.cuda] if load_backend(name).device == "cuda" else [])
    for name in backend_names()
    if name != "reference"
]


@pytest.fixture(autouse=True)
def its_backend_runs(request):
    """Asked in the test, not where tests are found: a package may compile for minutes to answer."""
    backend = getattr(request.node, "callspec", None) and request.node.callspec.params.get("backend")
    if backend:
        need(backend)


IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 1e-4, 1e-3
NAMES = ("means", "quats", "scales", "opacities", "colors")


def render(parameters, camera, size, backend, weights=None, **options):
    """Image, alpha, gradients by name (None without weights), meta; everything as float64."""
    kind = {"dtype": torch.float64 if backend == "reference" else torch.float32, "device": load_backend(backend).device}
    leaves = [p.detach().to(**kind).requires_grad_() for p in parameters]
    camera = [t.to(**kind) for t in camera]
    if options.get("backgrounds") is not None:
        options = {**options, "backgrounds": options["backgrounds"].to(**kind)}
    image, alpha, meta = rasterization(*leaves, *camera, *size, backend=backend, **options)
    grads = None
    if weights is not None:
        loss = (image * weights[0].to(**kind)).sum() + (alpha * weights[1].to(**kind)).sum()
        if loss.requires_grad:
            loss.backward()
        tensors = dict(zip(NAMES, leaves, strict=True))
        grads = {n: (torch.zeros_like(t) if t.grad is None else t.grad).double().cpu() for n, t in tensors.items()}
        seen = [m.grad for m in meta["means2d"] if m.grad is not None]
        if seen:
            grads["means2d"] = torch.stack(seen).double().cpu()
    meta["radii"] = meta["radii"].cpu()
    return image.detach().double().cpu(), alpha.detach().double().cpu(), grads, meta


def undecided_pixels(parameters, camera, size, **options) -> tuple[torch.Tensor, torch.Size]:
    """Pixels (C, H, W) where a rounding error may flip one of the blend's thresholds, and the shape of an image."""
    images = []
    blending = options.pop("blending", AS_3DGS)
    for factor in (1 - 1e-4, 1.0, 1 + 1e-4):
        image, alpha, _, _ = render(parameters, camera, size, "reference", blending=blending.moved(factor), **options)
        images.append(torch.cat([image, alpha], dim=-1))
    moved = (images[0] - images[1]).abs() + (images[2] - images[1]).abs()
    return moved.amax(dim=-1) > 1e-6, image.shape


def compare(parameters, camera, size, backend, seed=0, **options):
    """Assert that a backend agrees with the reference in image, alpha, radii and all gradients."""
    constants = load_backend(backend).constants()
    own = {} if constants is None else {"blending": constants}
    unsure, shape = undecided_pixels(parameters, camera, size, **options, **own)
    assert unsure.float().mean() < 0.05
    sure = (~unsure)[..., None].double()
    g = torch.Generator().manual_seed(seed)
    weights = (
        torch.randn(shape, generator=g, dtype=torch.float64) * sure,
        torch.randn((*shape[:3], 1), generator=g, dtype=torch.float64) * sure,
    )
    expected = render(parameters, camera, size, "reference", weights, **options, **own)
    got = render(parameters, camera, size, backend, weights, **options)
    scale = max(1.0, expected[0].abs().max().item() if expected[0].numel() else 1.0)
    assert ((got[0] - expected[0]) * sure).abs().max() < IMAGE_TOLERANCE * scale
    assert ((got[1] - expected[1]) * sure).abs().max() < IMAGE_TOLERANCE
    if backend != "cuda":  # gsplat's radii depend on the opacity
        assert torch.equal(got[3]["radii"], expected[3]["radii"])
    for name, want in expected[2].items():
        error = (got[2][name] - want).norm() / want.norm().clamp_min(1e-8)
        assert error < GRADIENT_TOLERANCE, f"gradient of {name}: {error:.1e}"


@pytest.mark.parametrize("backend", FAST_BACKENDS)
@pytest.mark.parametrize(
    ("mode", "channels", "degree"),
    [(m, c, d) for m in ("RGB", "RGB+D", "RGB+ED") for c in (1, 3) for d in (None, 0, 1, 2, 3)]
    + [("D", 1, None), ("ED", 1, None)]  # depth alone does not depend on colours
    + [("RGB+D", 5, 3), ("RGB", 6, 1), ("RGB", 6, None)],
)
def test_agrees_with_reference(backend, mode, channels, degree):
    parameters = random_gaussians(150, seed=channels, degree=degree, channels=channels)
    backgrounds = torch.full((1, channels), 0.3) if channels == 3 else None
    compare(
        parameters, turned_camera(53, 37), (53, 37), backend,
        sh_degree=degree, render_mode=mode, backgrounds=backgrounds,
    )  # fmt: skip


@pytest.mark.parametrize("backend", ["reference", *FAST_BACKENDS])
def test_no_gaussians(backend):
    image, alpha, _, meta = render(
        random_gaussians(0, 0, None, 3), turned_camera(20, 10), (20, 10), backend,
        backgrounds=torch.tensor([[0.1, 0.2, 0.3]]), render_mode="RGB+D",
    )  # fmt: skip
    assert torch.allclose(image[0, 4, 5], torch.tensor([0.1, 0.2, 0.3, 0.0]).double())
    assert alpha.abs().max() == 0 and meta["radii"].shape == (1, 0)


@pytest.mark.parametrize("backend", FAST_BACKENDS)
@pytest.mark.parametrize("part", range(4), ids=NAMES[:4])
def test_a_nan_is_in_every_pixel(backend, part):
    """Also of a Gaussian in a register that is not full."""
    for row in (7, 39):
        given = random_gaussians(40, 3, None, 3)
        given[part][row].view(-1)[-1] = torch.nan
        image, alpha, _, _ = render(given, turned_camera(20, 15), (20, 15), backend, render_mode="RGB+D")
        assert image.isnan().all() and alpha.isnan().all()


@pytest.mark.parametrize("backend", FAST_BACKENDS)
def test_several_cameras(backend):
    view, K = turned_camera(30, 20)
    moved = view.clone()
    moved[0, 0, 3] += 0.3
    cameras = (torch.cat([view, moved]), torch.cat([K, K]))
    compare(random_gaussians(60, 5, 2, 3), cameras, (30, 20), backend, sh_degree=2, render_mode="RGB+D")


@pytest.mark.parametrize("backend", FAST_BACKENDS)
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), spread=st.floats(-6, 0.5), degree=st.sampled_from([None, 0, 3]))
def test_random_scenes(backend, seed, spread, degree):
    parameters = random_gaussians(40, seed, degree, 1)
    parameters[2] *= torch.exp(torch.tensor(spread))
    compare(parameters, turned_camera(33, 21), (33, 21), backend, seed, sh_degree=degree, render_mode="RGB+D")


def test_bitwise_equal_on_any_number_of_threads():
    results = []
    parameters = random_gaussians(3000, 11, 1, 3)
    weights = torch.randn(1, 90, 120, 4), torch.randn(1, 90, 120, 1)
    for threads in (1, 2, 3):
        pool.set_threads(threads)
        image, alpha, grads, _ = render(
            parameters, turned_camera(120, 90), (120, 90), "cpu", weights, sh_degree=1, render_mode="RGB+D"
        )
        results.append([image, alpha, *grads.values()])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.slow
def test_the_other_width_of_registers():
    """Kernels compiled for the width that this processor does not choose, in a process of their own, agree as well."""
    lanes = "16" if jit.lanes() == 8 else "8"
    chosen = "(test_several_cameras or test_random_scenes or test_bitwise_equal_on_any or test_agrees) and not warp"
    run = subprocess.run(
        [sys.executable, "-m", "pytest", __file__, "-x", "-k", chosen, "-p", "no:cacheprovider"],
        env={**os.environ, "TDGBENCH_LANES": lanes}, cwd=ROOT, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-3000:]
    assert " passed" in run.stdout


def test_reference_gradients_are_finite_differences():
    parameters = [p.double().requires_grad_() for p in random_gaussians(5, 1, 2, 1)]
    camera = turned_camera(6, 5)

    def image(*leaves):
        out, alpha, _ = rasterization(
            *leaves, *camera, 6, 5, sh_degree=2, render_mode="RGB+D", backend="reference",
            blending=Blending(min_alpha=0.0),  # thresholds have no derivative
        )  # fmt: skip
        return out, alpha

    assert torch.autograd.gradcheck(image, parameters, eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("backend", ["reference", *FAST_BACKENDS])
def test_one_gaussian_by_hand(backend):
    """A round Gaussian on the axis: alpha at its centre is its opacity, off it falls by the projected width."""
    means = torch.tensor([[0.0, 0.0, 4.0]])
    scales, opacity = torch.full((1, 3), 0.2), torch.tensor([0.8])
    K = torch.tensor([[[50.0, 0, 10.5], [0, 50.0, 8.5], [0, 0, 1]]])
    parameters = [means, torch.tensor([[1.0, 0, 0, 0]]), scales, opacity, torch.tensor([[0.25]])]
    image, alpha, _, meta = render(parameters, (torch.eye(4)[None], K), (21, 17), backend, render_mode="RGB+D")
    variance = (50 * 0.2 / 4) ** 2 + 0.3
    beside = 0.8 * torch.exp(torch.tensor(-0.5 * 9 / variance)).item()
    assert alpha[0, 8, 10, 0].item() == pytest.approx(0.8, abs=1e-6)
    assert alpha[0, 8, 13, 0].item() == pytest.approx(beside, abs=1e-5)
    assert image[0, 8, 10].tolist() == pytest.approx([0.25 * 0.8, 4.0 * 0.8], abs=1e-5)
    # ceil(3 sqrt(6.55 + sqrt(0.1))); gsplat: ceil(sqrt(2 ln(0.8 · 255) · 6.55))
    assert meta["radii"][0, 0] == (9 if backend == "cuda" else 8)


def test_wrong_arguments_are_named():
    good = random_gaussians(4, 0, None, 3)
    camera = turned_camera(8, 8)
    with pytest.raises(ValueError, match="quats has shape"):
        rasterization(good[0], good[0], *good[2:], *camera, 8, 8)
    with pytest.raises(ValueError, match="render_mode"):
        rasterization(*good, *camera, 8, 8, render_mode="rgb")
    with pytest.raises(ValueError, match="backend"):
        rasterization(*good, *camera, 8, 8, backend="gpu")
    with pytest.raises(ValueError, match="sh_degree 1 needs 4"):
        rasterization(*good[:4], torch.zeros(4, 1, 3), *camera, 8, 8, sh_degree=1)
    with pytest.raises(ValueError, match="float32"):
        rasterization(*(p.double() for p in good), *camera, 8, 8, backend="cpu")


@pytest.mark.parametrize("backend", [name for name in FAST_BACKENDS if name.values != ("cuda",)])
@pytest.mark.parametrize(
    "blending",
    [
        Blending(min_alpha=1e-3),
        Blending(min_alpha=0.05, min_transmittance=0.01),
        Blending(max_alpha=0.5),
        Blending(min_alpha=1e-30, min_transmittance=0.0),
    ],
    ids=["fainter", "coarser", "capped", "without thresholds"],
)
def test_other_constants_agree_with_reference(blending, backend):
    compare(
        random_gaussians(150, 4, None, 3), turned_camera(53, 37), (53, 37), backend, render_mode="RGB+D",
        blending=blending,
    )  # fmt: skip


def test_the_shortcut_changes_the_way_and_not_the_result():
    parameters, camera, size = random_gaussians(300, 5, None, 1), turned_camera(70, 40), (70, 40)
    parameters[3][:] = 0.9  # tiles fill up
    weights = torch.randn(1, 40, 70, 1), torch.randn(1, 40, 70, 1)
    plain = render(parameters, camera, size, "cpu", weights)
    other = render(parameters, camera, size, "cpu", weights, blending=replace(AS_3DGS, end_early=False))
    assert torch.equal(other[0], plain[0])
    for name, want in plain[2].items():
        assert (other[2][name] - want).norm() / want.norm().clamp_min(1e-8) < 1e-4, name


def test_constants_that_cannot_be_are_refused():
    for wrong in ({"min_alpha": -0.1}, {"min_alpha": 0.99}, {"max_alpha": 1.0}, {"min_transmittance": 1.0}):
        with pytest.raises(ValueError, match="must be"):
            Blending(**wrong)
    with pytest.raises(ValueError, match="min_alpha above 0"):
        rasterization(
            *random_gaussians(3, 0, None, 1), *turned_camera(8, 8), 8, 8, backend="cpu", blending=Blending(min_alpha=0)
        )
