from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from tdgbench.bench.scores import render_images, render_views, write_renders
from tdgbench.cells.folder import CellFolder
from tdgbench.cells.record import Record
from tdgbench.cells.renders import blending_of, render_model
from tdgbench.splats.view import AS_3DGS
from tests.helpers.records import record
from tests.helpers.training import ready_to_train


def test_renders_of_a_method_are_those_of_its_model(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    view = small_gray_scene.test[0]
    images = render_images(trainer, view)
    stored = render_model(trainer.gaussians["thermal"].gaussians.detach(), view.camera)
    assert images.image.shape == (36, 48, 1) and images.depth.shape == (36, 48) and not images.others
    assert torch.allclose(stored.image, torch.from_numpy(images.image), atol=1e-6)


def test_pairs_of_pictures(small_scene, tmp_path):
    trainer = ready_to_train(small_scene, "msmg", 3)
    views = small_scene.test
    renders = render_views(trainer, views)
    write_renders(renders, views, tmp_path)
    names = {f"{view.name}.png" for view in views}
    for folder in ("renders", "targets", "renders_rgb", "targets_rgb"):
        assert {p.name for p in (tmp_path / folder).iterdir()} == names
    target = np.asarray(Image.open(tmp_path / "targets" / f"{views[0].name}.png"))
    assert np.abs(target / 255 - views[0].thermal).max() <= 0.5 / 255 + 1e-6
    cell = CellFolder(tmp_path, record())
    for view in views:
        known = cell.determinacy(view.name)
        assert np.abs(known - renders[view.name].determinacy).max() <= 0.5 / 255 + 1e-6 and known.max() > 0.4
    (tmp_path / "determinacy" / f"{views[0].name}.png").unlink()
    with pytest.raises(
        ValueError, match=f"determinacy/{views[0].name}.png is missing; run a cell of an earlier version again"
    ):
        cell.determinacy(views[0].name)


def test_a_cell_of_a_gpu_is_rendered_again_with_its_constants():
    """Whatever is installed here: gsplat before 1.6 caps alpha at 0.999."""
    record = Record("3dgs", "synthetic", "orbit", "colmap", 0, "e", "")
    record.environment = {"packages": {"gsplat": "1.5.3"}}
    caps = []
    for record.backend in ("cuda", "cpu", "", "a plug-in of elsewhere"):
        caps.append(blending_of(record).max_alpha)
    assert caps == [0.999, 0.99, 0.99, 0.99]
    record.backend, record.environment = "cuda", {"packages": {"gsplat": "1.6.0"}}
    assert blending_of(record) == AS_3DGS
    record.environment = {}
    assert blending_of(record) == AS_3DGS


def test_a_method_that_renders_no_depth_or_another_size_is_named(small_gray_scene, monkeypatch):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    render = trainer.method.model.render(small_gray_scene.test[0].camera)
    narrow = replace(render, image=render.image[:, 1:], depth=render.image[..., 0])
    for wrong, said in ((render, "no depth"), (narrow, r"\(36, 47, 1\) for thermal of view")):
        monkeypatch.setattr(trainer.method, "render", lambda frame, wrong=wrong: wrong)
        with pytest.raises(TypeError, match=rf"3dgs\.render gives {said}"), torch.no_grad():
            render_images(trainer, small_gray_scene.test[0])
