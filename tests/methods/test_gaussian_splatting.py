import pytest

from tdgbench.training.losses import photometric
from tests.helpers.training import trained


def test_is_the_photometric_loss_alone(small_scene):
    method = trained(small_scene, "3dgs", 2)[0].method
    step = method.step(3)
    assert step.loss.item() == pytest.approx(photometric(step.render.image, step.target, 0.2).item())
    assert method.modalities == ("thermal",) and not method.needs_prior


def test_the_weight_scales_the_loss_and_not_its_term(small_gray_scene):
    logs = [
        trained(small_gray_scene, "msmg_thermal", 1, **{"method.method.weight": weight})[1].lines[0]
        for weight in (1.0, 0.3)
    ]
    assert logs[1].loss == pytest.approx(0.3 * logs[0].loss, rel=1e-5)
    assert logs[1].terms["thermal"] == pytest.approx(logs[0].terms["thermal"])
