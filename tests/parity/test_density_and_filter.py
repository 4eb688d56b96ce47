"""AbsGS's decisions and Mip-Splatting's 3-D filter, against the authors' code."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl
from tdgbench.splats.filter import FIELD, Filter, filtered
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tests.helpers.configs import config
from tests.helpers.gaussians import RATES
from tests.parity.originals import original, relative

CLOSE = 1e-5


def state_of(data, prefix="", **fields) -> TrainingState:
    means, log_scales, quats, logits = (
        torch.from_numpy(data[prefix + name]) for name in ("xyz", "scaling", "rotation", "opacity")
    )
    sh, fields = torch.arange(float(len(means)))[:, None, None], {FIELD: torch.zeros(len(means), 1), **fields}
    return TrainingState(Gaussians(means, log_scales, quats, logits[:, 0], sh, fields))


@pytest.mark.parametrize(("case", "iteration"), [("early", 600), ("late", 3100)])
def test_absgs_clones_splits_and_prunes_as_many(case, iteration):
    data = original("absgs")
    rules = instantiate(config("budget=paper", "+density=absgs").budget.density)
    state = state_of(data, f"{case}_")
    density = DensityControl(rules, float(data["extent"]), state, 30_000)
    order = state.split(state.values).sh[:, 0, 0].long().numpy()  # the state sorts them in space
    for total, name in (
        (density.grad_sum, "signed"), (density.absolute_sum, "absolute"), (density.view_counts, "views")
    ):  # fmt: skip
        total.copy_(torch.from_numpy(data[f"{case}_{name}"][order]))
    rates = {FIELD: 0.0}
    change = density.update(Adam(state, RATES, 1.0, rates), iteration, torch.Generator().manual_seed(0))
    assert [change.cloned, change.split, len(state)] == data[f"{case}_counts"].tolist()


def test_absgs_caps_opacities():
    data = original("absgs")
    rules = instantiate(config("budget=paper", "+density=absgs").budget.density)
    many = {"early_opacity": data["cap_before"][:, None]}
    state = state_of({**data, **many}, "early_")
    order = state.split(state.values).sh[:, 0, 0].long().numpy()
    density = DensityControl(rules, float(data["extent"]), state, 30_000)
    assert density.update(Adam(state, RATES, 1.0, {FIELD: 0.0}), 500, torch.Generator()).opacity_reset
    assert relative(state.split(state.values).opacities, data["cap_after"][order]) < CLOSE


def test_mip_splattings_filter():
    data = original("mip_filter")
    cameras = []
    for k in range(5):
        fx, fy, width, height = data[f"intrinsics{k}"]
        K = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]])
        cameras.append(SimpleNamespace(world_to_camera=data[f"view{k}"], K=K, width=int(width), height=int(height)))
    rule = instantiate(config("budget=paper", "+filter=mip").budget.filter)
    filters, state = Filter(rule, cameras), state_of(data)
    order = state.split(state.values).sh[:, 0, 0].long().numpy()
    filters.update(state)
    some = state.split(state.values)
    assert relative(some.extra_fields[FIELD][:, 0], data["filter"][order]) < CLOSE
    scales, factor = filtered(some.scales, some.extra_fields[FIELD])
    assert relative(scales, data["scales"][order]) < CLOSE
    assert relative(some.opacities * factor, data["opacities"][order]) < CLOSE
    filters.cap(state, 0.01)
    reset = state.split(state.values)
    assert relative(reset.opacities * factor, data["reset_opacities"][order]) < CLOSE
    certain = np.abs(data["reset_logits"][order]) < 8  # beyond, float32 of an opacity has few digits
    assert certain.sum() > 250
    assert relative(reset.opacity_logits[certain], data["reset_logits"][order][certain]) < 1e-3
