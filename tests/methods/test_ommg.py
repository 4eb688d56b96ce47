"""OMMG: one geometry, two colour sets, and the gradient that density control reads; RGB renders of MMOne, too."""

import pytest
import torch

from methods.mmone import OPACITY_RGB
from methods.ommg import BOTH_COLORS, RGB_COLORS
from tdgbench.training.images import RGB
from tdgbench.training.losses import photometric, thermal_loss
from tests.helpers.training import ready_to_train, take_gradients, train


@pytest.mark.parametrize("scene", ["small_gray_scene", "small_scene"])
def test_the_loss_is_half_of_both(scene, request):
    trainer = ready_to_train(request.getfixturevalue(scene), "ommg", 10)
    view = trainer.method.views.views[0]
    trainer.method.views.next = lambda: view
    step = trainer.stage.step(1)
    rgb = trainer.method.model.render(view.camera, hook=RGB_COLORS).image
    expected = photometric(rgb, RGB.tensors_of(view, rgb.device)[0], 0.2).item()
    expected += thermal_loss(step.render.image, step.target, 0.2, 0.6, "released").item()
    assert step.loss.item() == pytest.approx(expected / 2, rel=1e-5)


def test_density_control_reads_one_gradient_of_the_sum(small_gray_scene):
    """Two renders of a view would be counted as two views, and their gradients could not cancel."""
    model = ready_to_train(small_gray_scene, "ommg", 10).method.model
    camera = small_gray_scene.train[0].camera

    def gradient(hook, channels):
        """Return that of the means on the image (N, 2), of one view."""
        model.render(camera, hook=hook).image[..., channels].square().sum().backward()
        assert len(model._views) == 1
        index, _, image = take_gradients(model).rows()
        return torch.zeros(len(model), 2).index_add(0, index, image[:, :2])

    both, gray, rgb = (
        gradient(BOTH_COLORS, slice(0, 4)),
        gradient(None, slice(0, 1)),
        gradient(RGB_COLORS, slice(0, 3)),
    )
    assert torch.allclose(both, gray + rgb, rtol=1e-3, atol=1e-5 * float(both.abs().max()))


@pytest.mark.parametrize("name", ["ommg", "mmone"])
@pytest.mark.parametrize("background", ["black", "mean"])
def test_rgb_is_rendered_over_black(small_gray_scene, background, name):
    trainer = ready_to_train(small_gray_scene, name, 3, f"budget.background={background}")
    train(trainer)
    model = trainer.method.model
    for logits in (model.gaussians.opacity_logits, model.gaussians.extra_fields.get(OPACITY_RGB, torch.zeros(0))):
        logits.fill_(-20)  # nothing but the background is left
    frame = trainer.context.frame(small_gray_scene.test[0])
    rgb, gray = trainer.method.render(frame, "rgb").image, trainer.method.render(frame)
    assert rgb.shape[2] == 3 and float(rgb.max()) == 0 and gray.depth is not None
    assert float(gray.image.max()) == (0 if background == "black" else pytest.approx(model.background.item()))
