"""The adapter to gsplat, against a stand-in that has gsplat's signature and shapes and renders with the reference.

What gsplat itself computes is checked by `test_rasterization.py` where a CUDA GPU is.
"""

import sys
import types

import pytest
import torch

from tdgbench.splats.backends import cuda, reference
from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.rasterization import choose_backend
from tests.conftest import random_gaussians, turned_camera


def gsplat_rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01,
                         far_plane=1e10, radius_clip=0.0, eps2d=0.3, sh_degree=None, packed=True, tile_size=16,
                         backgrounds=None, render_mode="RGB", sparse_grad=False):  # fmt: skip
    """gsplat 1.5.3's face: renders (C, H, W, D), alphas (C, H, W, 1), means2d (C, N, 2), radii per axis (C, N, 2)."""
    assert not packed and backgrounds is None
    view = reference.rasterize(
        means, quats, scales, opacities, colors, viewmats[0], Ks[0], width, height, near_plane=near_plane,
        far_plane=far_plane, eps2d=eps2d, sh_degree=sh_degree, background=None, depth_channel=render_mode == "RGB+D",
        blending=AS_3DGS,
    )  # fmt: skip
    image = view.image if view.depth is None else torch.cat([view.image, view.depth[..., None]], dim=-1)
    means2d = view.means2d.detach()[None].requires_grad_()
    view.means2d.register_hook(lambda grad: means2d.backward(grad[None]))
    meta = {
        "means2d": means2d,
        "radii": torch.stack([view.radii, view.radii], dim=-1)[None],
        "depths": view.depths[None],
    }
    return image[None], 1 - view.transmittance[None, ..., None], meta


@pytest.fixture
def stand_in(monkeypatch):
    module = types.ModuleType("gsplat")
    module.rasterization = gsplat_rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)


@pytest.mark.parametrize(("degree", "depth", "background"), [(None, True, 0.3), (2, False, None), (2, True, None)])
def test_hands_over_and_takes_back(stand_in, degree, depth, background):
    given = [p.double() for p in random_gaussians(40, 3, degree, 3)]
    (view,), (K,) = (t.double() for t in turned_camera(20, 15))
    color = None if background is None else torch.full((3,), background, dtype=torch.float64)
    options = {
        "near_plane": 0.2, "far_plane": 1e10, "eps2d": 0.3, "sh_degree": degree, "background": color,
        "depth_channel": depth,
    }  # fmt: skip
    results = []
    for rasterize, extra in ((cuda.rasterize, {}), (reference.rasterize, {"blending": AS_3DGS})):
        leaves = [p.clone().requires_grad_() for p in given]
        out = rasterize(*leaves, view, K, 20, 15, **options, **extra)
        g = torch.Generator().manual_seed(0)
        parts = [out.image, out.transmittance, *([out.depth] if depth else [])]
        sum((p * torch.randn(p.shape, generator=g, dtype=torch.float64)).sum() for p in parts).backward()
        results.append(
            [*parts, out.radii.double(), out.depths, out.means2d, out.means2d.grad, *(p.grad for p in leaves)]
        )
        assert (out.depth is not None) == depth
    for ours, theirs in zip(*results, strict=True):
        assert torch.allclose(ours, theirs, atol=1e-12)


def test_without_a_gpu_it_says_why():
    if cuda.why_not() is None:
        pytest.skip("a CUDA GPU and gsplat are here")
    assert "gsplat is not installed" in cuda.why_not() or "no CUDA GPU" in cuda.why_not()
    with pytest.raises(RuntimeError, match="backend cuda cannot run"):
        choose_backend("cuda", torch.device("cuda"), torch.float32)
    with pytest.raises(ValueError, match="float32 tensors on a CUDA GPU"):
        choose_backend("cuda", torch.device("cpu"), torch.float32)
