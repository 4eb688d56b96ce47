"""Mip-Splatting's filters in renders, their gradients, and cells that are trained with them."""

import math
import shutil
from itertools import pairwise

import numpy as np
import pytest
import torch
from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.run_cell import run_cell
from tdgbench.splats.filter import FIELD, Filter, FilterRule, compensation
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.verify import verify_cell
from tdgbench.view.cells import open_cell
from tests.helpers.configs import SMALL, config
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.helpers.training import ready_to_train, take_gradients, train

RULE = FilterRule(variance=0.2, kernel=0.1, every=100)
K = torch.tensor([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]])


def facing(variance: float) -> GaussianTensors:
    """One on the axis, of so many px² on the image, and one behind the camera."""
    means = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]])
    scales = torch.full((2, 3), math.sqrt(variance) * 2 / 50)
    return GaussianTensors(means, torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1), scales, torch.ones(2), torch.ones(2, 1))


@pytest.mark.parametrize("variance", [1e-4, 0.01, 0.1, 4.0])
def test_light_stays_where_the_kernel_widens(variance):
    """sqrt(det / det of the widened one), with the authors' floors; the thinnest ones vanish."""
    ratio = variance**2 / ((variance + 0.1) ** 2 + 1e-6) + 1e-6
    expected = 0.0 if variance**2 <= 1e-6 else math.sqrt(ratio)
    found = compensation(facing(variance), Pinhole(torch.eye(4), K, 40, 30), 0.1)
    assert found.tolist() == pytest.approx([expected, 1.0], rel=1e-4)


def test_gradients_of_the_compensation():
    view, intrinsics = (t[0].double() for t in turned_camera(40, 30))
    camera = Pinhole(view, intrinsics, 40, 30)
    means, quats, scales, *_ = (p.double() for p in random_gaussians(6, 2, None, 1))
    leaves = [means.requires_grad_(), quats.requires_grad_(), (0.3 * scales).detach().requires_grad_()]
    rest = (torch.ones(6).double(), torch.ones(6, 1).double())
    assert (compensation(GaussianTensors(*leaves, *rest), camera, 0.1) < 0.99).any()
    assert torch.autograd.gradcheck(
        lambda *given: compensation(GaussianTensors(*given, *rest), camera, 0.1), leaves, atol=1e-6
    )


def test_sizes_where_some_or_no_view_sees_a_gaussian(small_gray_scene):
    camera = small_gray_scene.train[0].camera
    centre = -camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3]
    ahead = camera.world_to_camera[2, :3]
    means = torch.from_numpy(np.stack([centre + 2 * ahead, centre + 3 * ahead, centre - ahead])).float()
    per_px = math.sqrt(0.2) / camera.K[0, 0]
    assert Filter(RULE, [camera]).sizes(means).tolist() == pytest.approx([2 * per_px, 3 * per_px, 3 * per_px], rel=1e-5)
    assert Filter(RULE, [camera]).sizes(means[2:]).tolist() == [0.0]


def test_when_sizes_are_computed_anew():
    due = [i for i in range(1, 1001) if Filter(RULE, []).is_due(i, 500, 1000)]
    assert due == [600, 700, 800]


def test_training_keeps_the_sizes_up_to_date(small_gray_scene):
    """After a round, and every so many iterations once density control has stopped; Adam leaves them alone."""
    overrides = ("+filter=mip", "budget.filter.every=7", "budget.density.start=4", "budget.density.stop=20")
    trainer = ready_to_train(small_gray_scene, "3dgs", 60, *overrides, "budget.density.every=8")
    model, sizes = trainer.method.model, []

    def sizes_now(log):
        field = model.copy().extra_fields[FIELD][:, 0]
        is_current = torch.allclose(field, model.filter.sizes(model.copy().means), rtol=1e-6)
        sizes.append((log.iterations, is_current, len(field), field.sort().values))

    start = model.filter.sizes(model.gaussians.means)
    assert torch.equal(start, model.gaussians.extra_fields[FIELD][:, 0])
    train(trainer, after_iteration=sizes_now)
    changed = {
        now[0] for last, now in pairwise(sizes) if now[2] != last[2] or not torch.equal(now[3], last[3])
    }  # fmt: skip
    assert changed == {8, 16, 21, 28, 35, 42, 49}
    assert {i for i, is_current, _, _ in sizes if is_current} >= {8, 16}


def test_a_thin_gaussian_is_rendered_wider_and_fainter(small_gray_scene):
    plain, wide = (
        ready_to_train(small_gray_scene, "3dgs", 10, *extra).method.model for extra in ((), ("+filter=mip",))
    )
    camera = small_gray_scene.train[0].camera
    for model in (plain, wide):
        model.gaussians.log_scales[:] = -9.0
    assert wide.render(camera).alpha.max() < 0.01 < plain.render(camera).alpha.max()
    for model in (plain, wide):
        model.gaussians.log_scales[:] = -1.0
    assert torch.allclose(wide.render(camera).image, plain.render(camera).image, atol=0.02)


def test_backends_agree(small_gray_scene):
    found = []
    for name in ("cpu", "reference"):
        model = ready_to_train(small_gray_scene, "3dgs", 10, "+filter=mip", f"backend={name}").method.model
        image = model.render(small_gray_scene.train[0].camera).image
        (image * torch.linspace(-1, 1, image.numel()).reshape(image.shape)).sum().backward()
        found.append((image.detach(), take_gradients(model).values))
    (image, gradients), (wanted, exact) = found
    assert torch.allclose(image, wanted, atol=1e-4)
    assert (gradients - exact).norm() < 1e-3 * exact.norm() > 0


def test_a_hook_must_keep_the_gaussians(small_gray_scene):
    model = ready_to_train(small_gray_scene, "3dgs", 10, "+filter=mip").method.model
    with pytest.raises(ValueError, match=r"renders 5 of \d+ Gaussians.*budget.filter=null"):
        model.render(small_gray_scene.train[0].camera, hook=lambda g, degree: g.select(slice(5)).activated(degree))


def test_it_is_not_for_growth_by_residuals(small_gray_scene):
    with pytest.raises(Exception, match=r"budget\.growth does not see what budget\.filter does"):
        ready_to_train(small_gray_scene, "3dgs", 10, "budget=lean", "+filter=mip")


@pytest.fixture(scope="module")
def cell(tmp_path_factory, data_root):
    results = tmp_path_factory.mktemp("filtered")
    cfg = config(
        *SMALL, "budget=demo", "budget.iterations=40", "method=3dgs", "scene=turntable", f"data.root={data_root}",
        f"results={results}", "+filter=mip", "budget.filter.every=10", "budget.density.stop=20",
    )  # fmt: skip
    assert run_cell(cfg, "", CellProgress(Console(quiet=True), 40)).status == "ok"
    (file,) = results.rglob("record.json")
    return results, file.parent


def test_a_stored_cell_is_rendered_with_its_filters(cell):
    results, folder = cell
    assert (load_ply(folder / "model.ply").extra_fields[FIELD] > 0).all() and (folder / "parts.pt").exists()
    assert verify_cell(folder) == []
    found = open_cell(folder)
    (record,) = read_all(results / "single")
    camera = next(iter(found.test.values()))
    assert found.method is not None and record.setting("budget.filter.kernel") == 0.1
    assert found.method.render_from(camera).image.shape[:2] == (camera.height, camera.width)


def test_without_them_it_would_look_different(cell, tmp_path):
    """The check of `verify` can fail."""
    copy = tmp_path / cell[1].relative_to(cell[0])
    shutil.copytree(cell[1], copy)
    (copy / "parts.pt").unlink()
    assert any(problem.startswith("renders/") for problem in verify_cell(copy))
