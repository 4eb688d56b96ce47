"""MMOne's density control and loss against the authors' code: sums, choices, order, opacities, counts, gradients."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from methods.mmone import OPACITY_RGB, SH_RGB, MMOne, MultimodalControl, MultimodalRules
from tdgbench.scenes import Camera, View
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityChange, TrainingView
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Render
from tests.helpers.configs import config
from tests.helpers.gaussians import RATES
from tests.parity.originals import difference, original, relative

CLOSE = 1e-5
EXTENT, WIDTH, HEIGHT = 3.0, 64, 32
RESET_EVERY = 3030  # so that a reset comes without a round; rounds are "late" after the first
ROUNDS = {"early": (600, 700, 3030), "late": (3100, 3200, 6060)}  # the last is the reset's
BOTH = [(reading, time) for reading in ("released", "described") for time in ROUNDS]


@pytest.fixture(scope="module")
def theirs() -> dict[str, np.ndarray]:
    return original("mmone")


def gaussians_of(data, prefix: str) -> Gaussians:
    """Return the original's Gaussians: its opacity and `f_*` are RGB's."""
    get = {k: torch.from_numpy(v) for k, v in ((k[len(prefix) :], v) for k, v in data.items() if k.startswith(prefix))}
    sh, sh_rgb = (torch.cat([get[f"{name}_dc"], get[f"{name}_rest"]], dim=1) for name in ("thermal", "rgb"))
    logits = get["opacity_thermal"].squeeze(1)
    extra = {SH_RGB: sh_rgb, OPACITY_RGB: get["opacity_rgb"]}
    return Gaussians(get["means"], get["log_scales"], get["quats"], logits, sh, extra)


def control(theirs, reading: str) -> MultimodalControl:
    """Return the start, in the order of the original, after three views."""
    cfg = config("method=mmone" if reading == "released" else "method=mmone_described", "budget=paper")
    density = {name: value for name, value in cfg.budget.density.items() if name != "_target_"}
    names = set(MultimodalRules.__dataclass_fields__) - {*density, "filled_at"}
    options = {name: cfg.method.method[name] for name in names}
    rules = replace(MultimodalRules(**density, **options), opacity_reset_every=RESET_EVERY)
    start = gaussians_of(theirs, "start_")
    state = TrainingState(start)
    state.values[:] = state.rows_of(start)
    state.refresh_bounds()
    found = rules.control(EXTENT, state, 30_000)
    nothing = state.values.new_zeros(len(start), state.columns)
    for number in range(3):
        radii = 5 * torch.from_numpy(theirs[f"view_seen_{number}"]).int()
        views = []
        for label in ("thermal", "rgb"):
            per_px = torch.from_numpy(theirs[f"view_{label}_{number}"]) / torch.tensor([0.5 * WIDTH, 0.5 * HEIGHT])
            gradients = Gradients.dense(nothing, per_px, radii)
            found.observe_visible(gradients)
            views.append(TrainingView(gradients, WIDTH, HEIGHT, label))
        found.observe(views)
    return found


@pytest.fixture
def same_draws(monkeypatch, theirs):
    """Returns a function after which children of splits have the original's draws."""

    def use(prefix: str) -> None:
        draws = torch.from_numpy(theirs[f"{prefix}_draws"])
        monkeypatch.setattr(torch, "randn", lambda *shape, **_: draws[: shape[0]])

    return use


def rows_of(gaussians: Gaussians) -> torch.Tensor:
    return torch.cat([tensor.flatten(1) if tensor.dim() > 1 else tensor[:, None] for _, tensor in gaussians.items()], 1)


def test_sums_of_three_views(theirs):
    found = control(theirs, "released")
    assert torch.equal(found.view_counts, torch.from_numpy(theirs["view_count"]))
    for ours, name in ((found.grad_sum, "norm"), (found.rgb_sum, "rgb"), (found.thermal_sum, "thermal")):
        assert relative(ours, theirs[f"view_sum_{name}"]) < CLOSE, name


@pytest.mark.parametrize("reading, time", BOTH)
def test_a_round_in_the_order_of_the_original(theirs, same_draws, reading, time):
    prefix = f"{reading}_{time}"
    found, change = control(theirs, reading), DensityChange()
    same_draws(prefix)
    decomposed = torch.from_numpy(theirs[f"{prefix}_decomposed"])
    assert torch.equal(found._decomposed(found._by_gradients().strength), decomposed)
    state, count, copies = found.state, len(found.state), int(decomposed.sum())
    removed, added = found.removed_and_added(change, ROUNDS[time][0], torch.Generator(), None)
    ours = state.split(state.values[decomposed]), state.split(added[:copies])
    for part, rows in zip(ours, (np.flatnonzero(decomposed), slice(count, None)), strict=True):
        for logits, name in ((part.extra_fields[OPACITY_RGB], "rgb"), (part.opacity_logits[:, None], "thermal")):
            assert relative(logits, theirs[f"{prefix}_after_decompose_opacity_{name}"][rows]) < CLOSE, name
    stays = torch.ones(count, dtype=torch.bool)
    stays[removed] = False
    left = rows_of(state.split(torch.cat([state.values[stays], added])))
    expected = rows_of(gaussians_of(theirs, f"{prefix}_after_"))
    assert left.shape == expected.shape
    assert float(((left - expected).abs() / expected.abs().clamp_min(1)).max()) < CLOSE
    assert count + change.cloned + change.split - change.pruned == len(expected)
    assert min(copies, change.cloned - copies, change.split, change.pruned) > 5


@pytest.mark.parametrize("reading, time", BOTH)
def test_the_next_round_and_a_reset(theirs, same_draws, reading, time):
    prefix = f"{reading}_{time}"
    found = control(theirs, reading)
    state, optimizer = found.state, Adam(found.state, RATES, EXTENT, {SH_RGB: "sh", OPACITY_RGB: "opacity_logits"})
    same_draws(prefix)

    def compare(step: str, means: str) -> None:
        now = state.split(state.values)
        ours = torch.cat([now.means, now.extra_fields[OPACITY_RGB], now.opacity_logits[:, None]], dim=1)
        names = (means, f"{step}_opacity_rgb", f"{step}_opacity_thermal")
        assert difference(ours.numpy(), np.concatenate([theirs[f"{prefix}_{name}"] for name in names], axis=1)) < CLOSE

    first, second, reset = ROUNDS[time]
    assert found.update(optimizer, first, torch.Generator()).densified
    compare("after", "after_means")
    assert found.update(optimizer, second, torch.Generator()).densified
    compare("second", "second_means")
    change = found.update(optimizer, reset, torch.Generator())
    assert change.opacity_reset and not change.densified
    compare("reset", "second_means")


def test_the_readings_differ_in_the_next_round(theirs):
    for time in ROUNDS:
        released, described = (len(theirs[f"{reading}_{time}_second_means"]) for reading in ("released", "described"))
        assert described < released


def test_the_loss_and_its_gradients_with_renders_beyond_0_and_1(theirs):
    """0.5 (L_rgb + L_thermal) of clamped renders, in double."""
    images = {
        name: torch.from_numpy(theirs[f"image_{name}"]).permute(1, 2, 0).contiguous().requires_grad_()
        for name in ("rgb", "thermal")
    }
    targets = {name: theirs[f"target_{name}"].transpose(1, 2, 0).copy() for name in images}
    height, width = targets["rgb"].shape[:2]
    view = View(
        "a", Camera(np.eye(3), np.eye(4), width, height), lambda: targets["thermal"], lambda: targets["rgb"]
    )  # fmt: skip
    method = MMOne(**{name: value for name, value in config("method=mmone").method.method.items() if name[0] != "_"})
    method.views = SimpleNamespace(next=lambda: view)
    method.model = SimpleNamespace(
        render=lambda camera, label, **_: Render(images[label], None, torch.zeros(height, width)),
        state=SimpleNamespace(values=torch.zeros(1)),
    )
    step = method.step(1)
    assert relative([step.loss.item()], [theirs["loss"]]) < CLOSE
    assert relative(list(step.numbers()[1].values()), [theirs[f"loss_{name}"] for name in step.terms]) < CLOSE
    step.loss.backward()
    for name, image in images.items():
        assert relative(image.grad.permute(2, 0, 1), theirs[f"grad_{name}"]) < CLOSE
        beyond = (image.detach() < 0) | (image.detach() > 1)
        assert beyond.any() and not image.grad[beyond].any()
