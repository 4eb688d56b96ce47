import numpy as np
import pytest
import torch
from PIL import Image

from tdgbench.bench.renders import render_images, render_model, render_views, write_renders
from tests.helpers.training import ready_to_train


def test_renders_of_a_method_are_those_of_its_model(small_gray_scene):
    method, _ = ready_to_train(small_gray_scene, "splat", 3)
    view = small_gray_scene.test[0]
    images = render_images(method, view, with_rgb=True)
    stored = render_model(method.models()["thermal"].gaussians.detach(), view.camera)
    assert images.image.shape == (36, 48, 1) and images.depth.shape == (36, 48) and images.rgb is None
    assert torch.allclose(stored.image, torch.from_numpy(images.image), atol=1e-6)


def test_pairs_of_pictures(small_scene, tmp_path):
    method, _ = ready_to_train(small_scene, "msmg", 3)
    views = small_scene.test
    write_renders(render_views(method, views), views, tmp_path)
    names = {f"{view.name}.png" for view in views}
    for folder in ("renders", "targets", "renders_rgb", "targets_rgb"):
        assert {p.name for p in (tmp_path / folder).iterdir()} == names
    target = np.asarray(Image.open(tmp_path / "targets" / f"{views[0].name}.png"))
    assert np.abs(target / 255 - views[0].thermal).max() <= 0.5 / 255 + 1e-6


def test_a_method_that_renders_no_depth_is_named(small_gray_scene, monkeypatch):
    method, _ = ready_to_train(small_gray_scene, "splat", 3)
    monkeypatch.setattr(method, "render", lambda camera: method.model.render(camera))
    with pytest.raises(TypeError, match=r"splat\.render gives no depth"), torch.no_grad():
        render_images(method, small_gray_scene.test[0], with_rgb=False)
