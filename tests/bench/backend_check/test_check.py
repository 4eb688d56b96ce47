"""The check accepts a backend that is right and refuses those that are wrong, each for its reason."""

import math

import pytest

from tdgbench.bench.backend_check import check as checking
from tdgbench.bench.backend_check.check import check, scenes
from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE, expected
from tdgbench.splats.backends import ON_GPU
from tests.helpers.backends import NotFinite, Raises, StandIn, Unsteady, WrongGradient, WrongValue, need, register


@pytest.fixture
def verdict_on(monkeypatch):
    return lambda backend: check(register(monkeypatch, backend))


@pytest.fixture
def one_scene(monkeypatch):
    """Wrong backends show it on the first scene."""
    first = dict([next(iter(scenes().items()))])
    monkeypatch.setattr(checking, "scenes", lambda: first)


def test_the_scenes_hold_what_they_are_for():
    """Degrees, channels, several tiles; Gaussians that no ray sees; few pixels that a rounding error could flip."""
    made = scenes()
    assert len(made) == 4
    assert {(c.degree, c.colors.shape[-1]) for c in made.values()} == {(3, 1), (None, 3), (1, 3), (1, 1)}
    assert (expected(made["opaque walls"], "reference").rendered.image[..., -1] > 0.999).double().mean() > 0.3
    for scene in made.values():
        assert scene.width > 48 and scene.height > 32
        want = expected(scene, "reference")
        assert want.undecided.double().mean() < 0.01
        assert all(gradient.norm() > 0.1 for gradient in want.rendered.gradients.values())
    unseen = expected(made["hidden, faint and opaque"], "reference").rendered.gradients["means"][:45].norm(dim=1)
    assert (unseen == 0).all()


def test_the_reference_in_float32_passes(verdict_on):
    verdict = verdict_on(StandIn())
    assert not verdict.reason and verdict.spread == 0
    assert 0 < verdict.image < IMAGE_TOLERANCE / 10 and 0 < verdict.gradients < GRADIENT_TOLERANCE / 10


def test_the_cpu_passes():
    verdict = check("cpu")
    assert not verdict.reason and verdict.spread == 0 and verdict.seconds > 0


def test_a_wrong_value_is_refused(verdict_on, one_scene):
    verdict = verdict_on(WrongValue())
    assert verdict.reason.startswith("image of the scene 'gray, harmonics of degree 3' is wrong by ")
    assert verdict.reason.endswith("allowed is 5e-05") and verdict.image > IMAGE_TOLERANCE


def test_a_wrong_gradient_is_refused(verdict_on, one_scene):
    verdict = verdict_on(WrongGradient())
    assert "gradients of the scene" in verdict.reason and "are wrong by" in verdict.reason
    assert verdict.image < IMAGE_TOLERANCE and 0.009 < verdict.gradients < 0.011


def test_values_that_are_not_finite_are_refused(verdict_on, one_scene):
    verdict = verdict_on(NotFinite())
    assert verdict.reason.endswith("is not finite") and math.isnan(verdict.image)


def test_an_error_is_a_reason_of_one_line(verdict_on, one_scene):
    broken = Raises()
    broken.error = AssertionError("torch.Size([120, 16, 1])")
    verdict = verdict_on(broken)
    assert verdict.reason == "AssertionError: torch.Size([120, 16, 1])"


def test_no_memory_is_a_reason(verdict_on, one_scene):
    verdict = verdict_on(Raises())
    assert verdict.reason.startswith("OutOfMemoryError: CUDA out of memory. Tried to allocate 2.00 MiB.")
    assert "\n" not in verdict.reason


def test_what_is_not_deterministic_is_told_and_not_refused(verdict_on, one_scene):
    verdict = verdict_on(Unsteady(1e-5))
    assert not verdict.reason and 1e-6 < verdict.spread < 1e-4


def test_what_is_not_deterministic_beyond_the_tolerance_is_refused(verdict_on, one_scene):
    """Its first render is right."""
    backend = Unsteady(1e-2)
    backend.renders = 1
    verdict = verdict_on(backend)
    assert verdict.reason.startswith("image") and backend.renders == 3


@pytest.mark.cuda
@pytest.mark.parametrize("backend", ON_GPU)
def test_the_gpu_passes(backend):
    need(backend)
    verdict = check(backend)
    assert not verdict.reason, verdict
