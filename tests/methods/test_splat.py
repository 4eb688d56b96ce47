import pytest

from tdgbench.training.losses import photometric
from tests.training.test_loop import trained


def test_is_the_photometric_loss_alone(small_scene):
    method, _ = trained(small_scene, "splat", 2)
    step = method.step(3)
    assert step.loss.item() == pytest.approx(photometric(step.thermal.image, step.target, 0.2).item())
    assert not method.needs_rgb and not method.needs_prior
