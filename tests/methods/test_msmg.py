import pytest
import torch

from tdgbench.training.context import ViewOrder
from tests.helpers.training import trained


def test_each_modality_has_a_model_and_views_of_its_own(small_gray_scene):
    trainer, _ = trained(small_gray_scene, "msmg", 3)
    models, method = trainer.gaussians, trainer.method
    assert set(models) == {"rgb", "thermal"} and not method.needs_prior
    assert not torch.equal(models["rgb"].gaussians.means, models["thermal"].gaussians.means)
    pairs = [(method.rgb_views.next().name, method.thermal_views.next().name) for _ in range(20)]
    assert any(a != b for a, b in pairs)
    frame = trainer.context.frame(small_gray_scene.test[0])
    thermal, rgb = (method.render(frame, name) for name in method.modalities)
    assert (thermal.image.shape, rgb.image.shape) == ((36, 48, 1), (36, 48, 3))
    assert thermal.depth is not None and rgb.depth is None and not rgb.image.requires_grad


@pytest.mark.parametrize("ended", ["rgb", "thermal"])
def test_a_model_that_its_images_end_is_trained_until_it_has_recovered(small_gray_scene, monkeypatch, ended):
    """From an opacity reset."""
    method = trained(small_gray_scene, "msmg", 3)[0].method
    monkeypatch.setattr(ViewOrder, "has_ended", property(lambda views: views is getattr(method, f"{ended}_views")))
    monkeypatch.setattr(getattr(method, ended), "has_recovered", lambda iteration: iteration >= 5)
    assert set(method.step(4).terms) == {"rgb", "thermal"} and set(method.step(5).terms) == {"rgb", "thermal"} - {ended}
