import pytest

from tests.training.test_loop import trained


def test_the_weight_scales_the_loss_and_not_its_term(small_gray_scene):
    logs = [
        trained(small_gray_scene, "thermal", 1, **{"method.method.weight": weight})[1].lines[0] for weight in (1.0, 0.3)
    ]
    assert logs[1].loss == pytest.approx(0.3 * logs[0].loss, rel=1e-5)
    assert logs[1].terms["thermal"] == pytest.approx(logs[0].terms["thermal"])


def test_it_is_one_model_without_rgb(small_gray_scene):
    method, log = trained(small_gray_scene, "thermal", 150)
    assert list(method.models()) == ["thermal"] and not method.needs_rgb
    assert log.lines[-1].psnr > log.lines[0].psnr + 2
