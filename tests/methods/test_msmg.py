import torch

from tests.helpers.training import trained


def test_two_models_of_their_own(small_gray_scene):
    models = trained(small_gray_scene, "msmg", 3)[0].gaussians
    assert set(models) == {"rgb", "thermal"}
    assert (models["rgb"].gaussians.channels, models["thermal"].gaussians.channels) == (3, 1)
    assert not torch.equal(models["rgb"].gaussians.means, models["thermal"].gaussians.means)


def test_views_are_drawn_independently(small_scene):
    method = trained(small_scene, "msmg", 1)[0].method
    pairs = [(method.rgb_views.next().name, method.thermal_views.next().name) for _ in range(20)]
    assert any(a != b for a, b in pairs)


def test_both_modalities_are_rendered_from_a_frame(small_gray_scene):
    trainer, _ = trained(small_gray_scene, "msmg", 1)
    method, frame = trainer.method, trainer.context.frame(small_gray_scene.test[0])
    assert method.modalities == ("thermal", "rgb") and not method.needs_prior
    thermal, rgb = (method.render(frame, name) for name in method.modalities)
    assert (thermal.image.shape, rgb.image.shape) == ((36, 48, 1), (36, 48, 3))
    assert thermal.depth is not None and rgb.depth is None and not rgb.image.requires_grad
