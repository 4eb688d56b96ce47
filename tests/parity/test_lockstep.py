"""Model, Adam, density control and the loop around them against TDg's training loop, iteration by iteration."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from tdgbench.scenes import Camera, PointCloud
from tdgbench.splats import Gaussians
from tdgbench.splats.density import DensityControl
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Render
from tdgbench.training import splat_model as model_module
from tdgbench.training.context import Context
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method, Step
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer
from tests.helpers.configs import config
from tests.helpers.deferred import apply_deferred_steps
from tests.parity.drive import HEIGHT, WIDTH, pull, visible_at
from tests.parity.originals import difference, matched, original

EXTENT = 3.0
RULES = ("start=10", "every=16", "opacity_reset_every=40")  # as the original was told
AS_RELEASED = ("round_recovery=0", "reset_recovery=0")
COLUMNS = 23
LIMIT = 1e-5
CAMERA = Camera(np.eye(3), np.eye(4), WIDTH, HEIGHT)
ORDINARY, DENSIFIES, RESETS, BOTH = 70, 64, 40, 80  # what is due at an iteration that may be the last


@pytest.fixture(scope="module")
def theirs() -> dict[str, np.ndarray]:
    return original("lockstep")


class _Pulled(torch.autograd.Function):
    @staticmethod
    def forward(ctx, anchor, deliver):
        ctx.deliver = deliver
        return torch.zeros(HEIGHT, WIDTH, 3)

    @staticmethod
    def backward(ctx, _):
        ctx.deliver()
        return None, None


def original_order(state: TrainingState) -> list[int]:
    """Columns of our rows in the order of the original's: means, log_scales, quats, opacity_logits, sh."""
    columns = [c for name in Gaussians.names() for c in range(*state.columns_of(name).indices(COLUMNS))]
    assert sorted(columns) == list(range(COLUMNS))
    return columns


def pulled_render(state, optimizer, camera, options, collect, backend):
    """Stands in for `render_state`: the visible rows are updated, and get given gradients."""
    iteration = optimizer.rendering
    columns = original_order(state)
    visible = visible_at(state.values[:, columns], iteration).nonzero().squeeze(1).int()
    apply_deferred_steps(optimizer, visible.numpy())
    given = pull(state.values[visible][:, columns], iteration)
    rows = torch.zeros(len(visible), state.values.shape[1])
    rows[:, columns] = given.rows
    per_px = given.image / torch.tensor([0.5 * WIDTH, 0.5 * HEIGHT])
    image = torch.cat([per_px, given.radii[:, None].float()], dim=1)
    whole = [(0, len(visible))]
    gradients = Gradients(whole, visible, rows, image, whole, visible, given.radii.int())
    anchor = torch.zeros((), requires_grad=True)
    return Render(_Pulled.apply(anchor, lambda: collect(gradients)), None, torch.zeros(HEIGHT, WIDTH))


class Pulled(Method):
    """A method whose only loss is that its Gaussians are pulled."""

    def __init__(self, start: np.ndarray) -> None:
        rows = torch.from_numpy(start)
        self.start = Gaussians(rows[:, :3], rows[:, 3:6], rows[:, 6:10], rows[:, 10], rows[:, 11:].unflatten(1, (4, 3)))

    def setup(self, context: Context) -> None:
        self.model = context.gaussians(start=self.start)

    def step(self, iteration: int) -> Step:
        self.model.optimizer.rendering = iteration
        render = self.model.render(CAMERA)
        return Step(render.image.sum(), {}, render, torch.zeros_like(render.image))


def pulled(start: np.ndarray, iterations: int) -> Trainer:
    """A training of so many iterations in a scene without views."""
    rules = [f"budget.density.{rule}" for rule in (*RULES, *AS_RELEASED)]
    length = (f"budget.iterations={iterations}", "budget.rates.means_steps=80", "budget.sh_degree=1")
    budget = instantiate(config("budget=paper", *length, *rules).budget)
    scene = SimpleNamespace(train=[], views=[], extent=EXTENT)
    return Trainer(Pulled(start), Context(scene, PointCloud(*np.zeros((2, 0, 3))), {}, budget, "cpu", 0))


@pytest.fixture
def same_draws(monkeypatch, theirs):
    """Gives each Gaussian that is split the draws that it had in the original, whatever its row."""
    rounds = iter(range(100))
    children = DensityControl._children

    def with_their_draws(self, parents: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        k = next(rounds)
        order = matched(parents[:, :3].numpy(), theirs[f"parents_{k}"])
        draws = torch.from_numpy(theirs[f"draws_{k}"]).unflatten(0, (2, -1))[:, order].flatten(0, 1)
        with monkeypatch.context() as patch:
            patch.setattr(torch, "randn", lambda *shape, **_: draws.reshape(shape))
            return children(self, parents, generator)

    monkeypatch.setattr(DensityControl, "_children", with_their_draws)
    monkeypatch.setattr(model_module, "render_state", pulled_render)


def rows_of(model: SplatModel) -> np.ndarray:
    model.optimizer.flush()
    return model.state.values[:, original_order(model.state)].numpy().copy()


def test_every_iteration(theirs, same_draws):
    """Counts at each of 80 iterations, parameters at some, before density control: 4 rounds and a reset in between."""
    trainer, counts, far = pulled(theirs["saved_1"], BOTH), [], {}
    model = trainer.gaussians["thermal"]

    def compare(log: TrainingLog) -> None:
        counts.append(len(model))
        if f"saved_{log.iterations}" in theirs:
            far[log.iterations] = difference(rows_of(model), theirs[f"saved_{log.iterations}"])

    train(trainer, before_update=compare)
    assert counts == theirs["counts"].tolist() and len(set(counts)) == 5
    assert far[1] == 0 and list(far) == [1, 2, 16, 40, 41, 64, 70, 80]
    assert max(far.values()) < LIMIT, far


@pytest.mark.parametrize("last", [ORDINARY, DENSIFIES, RESETS, BOTH])
def test_end_of_training(theirs, same_draws, last):
    """The model that is left is the one before the last iteration's density control, without a last step."""
    trainer = pulled(theirs["saved_1"], last)
    train(trainer)
    model = trainer.gaussians["thermal"]
    assert len(model) == theirs["counts"][last - 1]
    assert difference(rows_of(model), theirs[f"saved_{last}"]) < LIMIT
