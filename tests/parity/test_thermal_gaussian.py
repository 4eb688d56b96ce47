"""ThermalGaussian's other strategies against the authors' code: OMMG's density control, MFTG's second stage."""

from dataclasses import replace

import pytest
import torch
from hydra.utils import instantiate

from methods.ommg import SH_RGB
from tdgbench.scenes import PointCloud
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityChange, DensityControl
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.state import TrainingState
from tests.helpers.configs import config
from tests.helpers.training import at_thermal_stage
from tests.parity.originals import difference, original, relative

CLOSE = 1e-5
EXTENT = 3.0


def gaussians_of(data, prefix: str) -> Gaussians:
    get = {name.removeprefix(prefix): torch.from_numpy(data[name]) for name in data if name.startswith(prefix)}
    sh, sh_rgb = (torch.cat([get[f"{name}_dc"], get[f"{name}_rest"]], dim=1) for name in ("thermal", "rgb"))
    return Gaussians(get["means"], get["log_scales"], get["quats"], get["opacity"][:, 0], sh, {SH_RGB: sh_rgb})


def rows_of(gaussians: Gaussians) -> torch.Tensor:
    return torch.cat([tensor.reshape(len(gaussians), -1) for _, tensor in gaussians.items()], dim=1)


def test_both_colour_sets_of_ommg_start_from_the_points():
    data = original("ommg")
    ours, theirs = gaussians_from_points(data["points"], data["colors"], 3, 1), gaussians_of(data, "first_")
    assert torch.equal(theirs.sh, theirs.extra_fields[SH_RGB])
    assert difference(rows_of(ours).numpy(), rows_of(replace(theirs, extra_fields={})).numpy()) < CLOSE


@pytest.mark.parametrize("case, iteration", [("early", 600), ("late", 3100)])
def test_ommg_clones_splits_and_prunes_both_colour_sets(monkeypatch, case, iteration):
    """One round, in the order of the original; late: after the first reset, where large Gaussians go."""
    data = original("ommg")
    start, expected = gaussians_of(data, f"{case}_start_"), gaussians_of(data, f"{case}_after_")
    state = TrainingState(start)
    state.values[:] = state.rows_of(start)
    state.refresh_bounds()
    found = DensityControl(instantiate(config("method=ommg", "budget=paper").budget.density), EXTENT, state, 30_000)
    found.grad_sum.copy_(torch.from_numpy(data[f"{case}_total"]))
    found.view_counts.copy_(torch.from_numpy(data[f"{case}_views"]))
    monkeypatch.setattr(torch, "randn", lambda *_, **__: torch.from_numpy(data[f"{case}_draws"]))
    change = DensityChange()
    removed, added = found.removed_and_added(change, iteration, torch.Generator(), None)
    stays = torch.ones(len(start), dtype=torch.bool)
    stays[removed] = False
    left = rows_of(state.split(torch.cat([state.values[stays], added])))
    assert [change.cloned, change.split, len(left)] == data[f"{case}_counts"].tolist()
    theirs = rows_of(expected)
    assert float(((left - theirs).abs() / theirs.abs().clamp_min(1)).max()) < CLOSE
    assert not torch.equal(expected.sh, expected.extra_fields[SH_RGB])


def test_mftg_starts_its_second_stage_from_the_cloud(small_scene):
    """40 Gaussians of the first stage become the 60 points again, without Adam's moments; the SH degree stays."""
    data = original("mftg")
    scene = replace(small_scene, points=PointCloud(data["points"], data["colors"]))
    trainer, start = at_thermal_stage(scene, "mftg", "budget.sh_degree=3", "budget.sh_every=10")
    assert len(data["rgb_means"]) == 40 and data["adam_steps"] == 0
    theirs = torch.cat([torch.from_numpy(data[f"thermal_rgb_{part}"]) for part in ("dc", "rest")], dim=1)
    order = torch.from_numpy(data["thermal_means"])[:, 0].argsort()
    ours = start["thermal"]
    by_place = ours.means[:, 0].argsort()
    assert relative(ours.sh[by_place], theirs[order]) < CLOSE
    for name, fields in (("means", ours.means), ("log_scales", ours.log_scales), ("quats", ours.quats)):
        assert relative(fields[by_place], data[f"thermal_{name}"][order]) < CLOSE, name
    assert relative(ours.opacity_logits[by_place, None], data["thermal_opacity"][order]) < CLOSE
    assert trainer.gaussians["thermal"].degree == int(data["degree"]) == 3
