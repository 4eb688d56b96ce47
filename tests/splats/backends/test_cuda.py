"""The adapter to gsplat, against a stand-in that has gsplat's signature and shapes and renders with the reference.

What gsplat itself computes is checked by `test_rasterization.py` and `test_check.py` where a CUDA GPU is.
"""

import sys
import types
from dataclasses import replace

import pytest
import torch

from tdgbench.splats.backends import choose_backend, cuda, reference
from tdgbench.splats.view import AS_3DGS, GaussianTensors, Pinhole, RenderOptions
from tests.helpers.gaussians import random_gaussians, turned_camera


def gsplat_rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01,
                         far_plane=1e10, radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=16,
                         backgrounds=None, render_mode="RGB", sparse_grad=False, absgrad=False):  # fmt: skip
    """gsplat 1.5.3's face: renders (C, H, W, D), alphas (C, H, W, 1), means2d (C, N, 2), radii per axis (C, N, 2)."""
    assert not packed and backgrounds is None
    if sh_degree is None:
        assert colors.shape[:-1] == means.shape[:-1]
    else:  # rendering.py of v1.5.3
        assert colors.dim() == 3 and colors.shape[-1] == 3 and (sh_degree + 1) ** 2 <= colors.shape[-2], colors.shape
    if render_mode == "D":
        colors, sh_degree = colors.new_zeros(len(means), 0), None
    gaussians = GaussianTensors(means, quats, scales, opacities, colors, sh_degree)
    camera = Pinhole(viewmats[0], Ks[0], width, height, near_plane, far_plane, eps2d)
    view = reference.BACKEND.render(gaussians, camera, RenderOptions(depth="D" in render_mode, absgrad=absgrad))
    image = view.image if view.depth is None else torch.cat([view.image, view.depth[..., None]], dim=-1)
    found = view.projection
    means2d = found.means2d.detach()[None].requires_grad_()

    def backward(grad):
        if absgrad:
            means2d.absgrad = found.absgrad[None].clone()
        means2d.backward(grad[None])

    found.means2d.register_hook(backward)
    meta = {
        "means2d": means2d,
        "radii": torch.stack([found.radii, found.radii], dim=-1)[None],
        "depths": found.depths[None],
    }
    return image[None], 1 - view.transmittance[None, ..., None], meta


@pytest.fixture
def stand_in(monkeypatch):
    module = types.ModuleType("gsplat")
    module.rasterization = gsplat_rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)


@pytest.mark.parametrize(
    ("degree", "channels", "depth", "background"),
    [(None, 3, True, 0.3), (2, 3, False, None), (2, 3, True, None), (3, 1, True, 0.2), (0, 1, False, None),
     (None, 1, True, None), (None, 0, True, None)],
)  # fmt: skip
def test_hands_over_and_takes_back(stand_in, degree, channels, depth, background):
    given = [p.double() for p in random_gaussians(40, 3, degree, channels)]
    (view,), (K,) = (t.double() for t in turned_camera(20, 15))
    color = None if background is None else torch.full((channels,), background, dtype=torch.float64)
    camera, options = Pinhole(view, K, 20, 15), RenderOptions(depth, color, absgrad=depth)
    results = []
    for backend in (cuda.BACKEND, reference.BACKEND):
        leaves = [p.clone().requires_grad_() for p in given]
        out = backend.render(GaussianTensors(*leaves, degree), camera, options)
        g = torch.Generator().manual_seed(0)
        parts = [out.image, out.transmittance, *([out.depth] if depth else [])]
        sum((p * torch.randn(p.shape, generator=g, dtype=torch.float64)).sum() for p in parts).backward()
        means2d, radii, depths, absgrad = out.projection
        used = leaves if channels else leaves[:-1]
        seen = [absgrad] if depth else []
        results.append([*parts, radii.double(), depths, means2d, means2d.grad, *seen, *(p.grad for p in used)])
        assert (out.depth is not None) == depth and (absgrad is not None) == depth
        assert not depth or (absgrad >= means2d.grad.abs() - 1e-12).all()
    for ours, theirs in zip(*results, strict=True):
        assert torch.allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize("part", ["means", "opacities"])
def test_a_nan_that_gsplat_hides_is_in_the_image(monkeypatch, part):
    module = types.ModuleType("gsplat")

    def without_nan(means, quats, scales, opacities, *rest, **options):
        return gsplat_rasterization(means.nan_to_num(), quats, scales, opacities.nan_to_num(), *rest, **options)

    module.rasterization = without_nan
    monkeypatch.setitem(sys.modules, "gsplat", module)
    given = GaussianTensors(*(p.double().requires_grad_() for p in random_gaussians(5, 3, None, 3)))
    (view,), (K,) = (t.double() for t in turned_camera(20, 15))
    good = cuda.BACKEND.render(given, Pinhole(view, K, 20, 15), RenderOptions()).image
    with torch.no_grad():
        getattr(given, part)[2] = torch.nan
    bad = cuda.BACKEND.render(given, Pinhole(view, K, 20, 15), RenderOptions()).image
    assert torch.isfinite(good).all() and torch.isnan(bad).all()


def test_other_constants_are_refused(stand_in):
    """Shortcuts concern only `cpu`, and do not matter here."""
    given = GaussianTensors(*(p.requires_grad_() for p in random_gaussians(5, 3, None, 1)))
    camera = Pinhole(*(t[0] for t in turned_camera(20, 15)), 20, 15)
    cuda.BACKEND.render(given, camera, RenderOptions(blending=replace(AS_3DGS, end_early=False)))
    with pytest.raises(ValueError, match="gsplat's constants"):
        cuda.BACKEND.render(given, camera, RenderOptions(blending=replace(AS_3DGS, min_alpha=0.1)))


def test_everything_is_handed_over_on_the_device_of_the_gaussians(monkeypatch):
    """The camera of a scene is float64 on the CPU."""

    def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, **options):
        tensors = (means, quats, scales, opacities, colors, viewmats, Ks)
        assert {(t.device.type, t.dtype) for t in tensors} == {("meta", torch.float32)}
        count = len(means)
        meta = {"means2d": means[None, :, :2], "radii": means.new_empty(1, count, 2), "depths": means[None, :, 2]}
        return means.new_empty(1, height, width, 4), means.new_empty(1, height, width, 1), meta

    module = types.ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
    given = GaussianTensors(*(p.to("meta") for p in random_gaussians(5, 3, 1, 3)), 1)
    camera = Pinhole(*(t[0].double() for t in turned_camera(20, 15)), 20, 15)
    view = cuda.BACKEND.render(given, camera, RenderOptions(depth=True, background=torch.zeros(3)))
    tensors = (view.image, view.depth, view.transmittance, *view.projection[:3])
    assert {t.device.type for t in tensors} == {"meta"} and view.image.shape == (15, 20, 3)


@pytest.mark.parametrize(
    ("version", "cap"), [("1.5.3", 0.999), ("1.5.3+pt24cu121", 0.999), ("1.6.0", 0.99), ("2.0", 0.99), (None, 0.999)]
)
def test_the_cap_of_alpha_follows_the_version(version, cap):
    constants = cuda.BACKEND.constants({"gsplat": version})
    assert constants == replace(AS_3DGS, max_alpha=cap)


@pytest.fixture
def gsplat_of(monkeypatch, tmp_path):
    """Put a gsplat with these lines in its files in the place of an installed one: `gsplat_of(init, backend)`."""
    names = ("gsplat", "gsplat.cuda", "gsplat.cuda._backend")

    def put(init, backend):
        (tmp_path / "gsplat" / "cuda").mkdir(parents=True)
        (tmp_path / "gsplat" / "__init__.py").write_text(init)
        (tmp_path / "gsplat" / "cuda" / "__init__.py").write_text("")
        (tmp_path / "gsplat" / "cuda" / "_backend.py").write_text(backend)
        for name in names:
            monkeypatch.delitem(sys.modules, name, raising=False)

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    cuda._import_problem.cache_clear()
    yield put
    cuda._import_problem.cache_clear()
    for name in names:
        sys.modules.pop(name, None)


def test_gsplat_that_cannot_be_imported_is_a_reason(gsplat_of):
    gsplat_of("raise ImportError('undefined symbol: _ZN3c10\\nand more')\n", "_C = None\n")
    assert cuda.BACKEND.why_not() == "gsplat cannot be imported (ImportError: undefined symbol: _ZN3c10)"


def test_gsplat_without_kernels_names_the_compiler(gsplat_of, monkeypatch):
    """As gsplat 1.5.3 is after its import on a machine without nvcc."""
    monkeypatch.setattr(torch.version, "cuda", "12.8")
    gsplat_of("", "_C = None\n")
    reason = cuda.BACKEND.why_not()
    assert "finds no nvcc" in reason and "CUDA toolkit 12.8" in reason and "C++ compiler" in reason


def test_gsplat_with_kernels_can_be_used(gsplat_of):
    gsplat_of("", "_C = object()\n")
    assert cuda.BACKEND.why_not() is None


def test_without_a_gpu_it_says_why():
    reason = cuda.BACKEND.why_not()
    if reason is None:
        pytest.skip("a CUDA GPU and gsplat are here")
    assert "gsplat is not installed" in reason or "no CUDA GPU" in reason
    with pytest.raises(RuntimeError, match="backend cuda cannot run"):
        choose_backend("cuda", torch.device("cuda"), torch.float32)
    with pytest.raises(ValueError, match="float32 tensors on a CUDA GPU"):
        choose_backend("cuda", torch.device("cpu"), torch.float32)
