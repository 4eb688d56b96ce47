"""The comparison finds wrong kernels."""

import pytest
import torch

from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE, Rendered, cloud, expected, render
from tdgbench.splats.backends import cpu
from tdgbench.splats.blending import AS_3DGS, Blending

SCENE = cloud(30)


def errors(change=lambda got: got, names=("means", "quats", "scales", "opacities", "colors", "means2d")):
    want = expected(SCENE, "cpu")
    return want.errors(change(render(SCENE, "cpu", want.weights)), names)


def test_a_sound_core():
    found = errors()
    assert found.image < 1e-6 and found.gradients < 1e-5


def test_a_wrong_pixel():
    def change(got: Rendered) -> Rendered:
        got.image[3, 4, 0] += 0.01
        return got

    assert 0.009 < errors(change).image < 0.011 and IMAGE_TOLERANCE < 0.009


@pytest.mark.parametrize("name", ["means", "scales", "means2d"])
def test_a_wrong_gradient(name):
    def change(got: Rendered) -> Rendered:
        return got._replace(gradients={**got.gradients, name: 1.01 * got.gradients[name]})

    assert 0.009 < errors(change).gradients < 0.011 and GRADIENT_TOLERANCE < 0.009
    assert errors(change, ["quats", "colors"]).gradients < 1e-5


def test_nan():
    found = errors(lambda got: got._replace(image=got.image * torch.nan))
    assert found.image != found.image
    found = errors(lambda got: got._replace(gradients={n: g * torch.nan for n, g in got.gradients.items()}))
    assert found.gradients != found.gradients


def test_a_backend_with_constants_of_its_own_is_compared_with_these(monkeypatch):
    """It is asked for the default ones, as gsplat is, and nevertheless blends with its own."""
    own, asked, original = Blending(max_alpha=0.5), [], cpu.CpuBackend.render

    def with_its_own(self, gaussians, camera, options):
        asked.append(options.blending)
        return original(self, gaussians, camera, options._replace(blending=own))

    monkeypatch.setattr(cpu.CpuBackend, "render", with_its_own)
    assert errors().image > 0.01
    monkeypatch.setattr(cpu.CpuBackend, "constants", lambda self, packages=None: own)
    assert errors().image < 1e-6 and set(asked) == {AS_3DGS}
