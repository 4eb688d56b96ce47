"""What a whole training step costs on a GPU: launches, waits of the host and copies, counted on a stand-in."""

import json
import os
import subprocess
import sys

import pytest
import torch.utils.backend_registration as registration

from tdgbench.splats.backends import warp
from tests.helpers.paths import ROOT

REASON = warp.BACKEND.why_not()
if REASON is None and not hasattr(registration, "_setup_privateuseone_for_python_backend"):
    REASON = "this torch has no devices in Python"
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))

SETS = {"tdg": 1, "msmg": 2}  # of Gaussians
MOST_LAUNCHES = {"tdg": 199, "msmg": 186}  # with a mask


@pytest.fixture(scope="module")
def found(data_root) -> dict[str, dict]:
    """What a process of its own finds on the stand-in: of steps, of what makes a host wait, of late errors."""
    environment = {**os.environ, "CUDA_VISIBLE_DEVICES": ""}  # one accelerator is enough
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + NOTICED + LATE + STEPS, str(data_root), *SETS], cwd=ROOT, env=environment,
        capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_a_step_waits_for_its_pairs_alone(found):
    """With active density control, with and without masks. Without a wait go learning rates, one copy per set of
    Gaussians, and come loss and flags of gradients that are not finite.
    """
    assert len(found["steps"]) == 2 * len(SETS)
    for name, steps in found["steps"].items():
        method = name.split(",")[0]
        assert len(steps) >= 5
        for step in steps:
            assert step["waits"] == {"_local_scalar_dense": SETS[method]}, name
            assert (step["to_device"], step["to_host"]) == (SETS[method], 1 + SETS[method])
            assert 40 < step["launches"] <= MOST_LAUNCHES[method], name


BEGIN = """
import json, os, sys
from pathlib import Path
import torch
from tdgbench.splats.transfer import start_copy_to_host
from tdgbench.training.budget import PlateauRule
from tdgbench.training.loop import train
from tdgbench.training.part import NonFiniteError, Stopping
from tdgbench.training.plateau import Plateau
from tests.helpers.masks import masked_scene
from tests.helpers.scenes import small_dataset
from tests.helpers.stand_in_gpu import NAME, Costs, install, steps_of
from tests.helpers.training import ready_to_train

costs, noticed, late, steps = Costs(), {}, {}, {}
install(costs)
scene = small_dataset(Path(sys.argv[1])).load("turntable")
"""
NOTICED = """
with costs:
    x, mask = torch.arange(6.0, device=NAME), torch.arange(6, device=NAME) > 3
    host, pinned = torch.ones(6), torch.ones(6).pin_memory()
    for name, call in {
        "item": lambda: x.sum().item(),
        "bool": lambda: bool(mask.any()),
        "tolist": lambda: x.tolist(),
        "read a mask's places": lambda: x[mask],
        "write them": lambda: x.__setitem__(mask, x[4:] * 2),
        "nonzero": lambda: mask.nonzero(),
        "to": lambda: host.to(NAME),
        "copy_": lambda: x.copy_(host),
        "cpu": lambda: x.cpu(),
        "read at once": lambda: start_copy_to_host(x)(),
        "read after a wait": lambda: (start_copy_to_host(x), x.sum().item())[0](),
        "not read": lambda: start_copy_to_host(x),
        "pageable": lambda: host.to(NAME, non_blocking=True),
        "pinned": lambda: pinned.to(NAME, non_blocking=True),
        "on the device": lambda: torch.where(mask, x, 0.0).index_add_(0, torch.arange(6, device=NAME), x),
    }.items():
        costs.clear()
        call()
        noticed[name] = sum(costs.waits.values())
    assert x.cpu().tolist() == [1.0] * 6
"""


def test_the_stand_in_notices_what_makes_a_host_wait(found):
    without = {"pinned": 0, "on the device": 0, "not read": 0}
    noticed = {name: count for name, count in found["noticed"].items() if name not in without}
    assert {name: found["noticed"][name] for name in without} == without
    assert noticed and set(noticed.values()) == {1}, noticed


# 1000 iterations have a line of the log at 1, 5, 10, ...
LATE = """
class Reader(Stopping):
    def reached(self, iteration, loss):
        self.losses = [*getattr(self, "losses", []), loss]
        return iteration == 4

def trainer_of(method, spoil=None, at=0, **more):
    trainer = ready_to_train(scene, method, 1000, "backend=warp")
    stage, trainer.losses = trainer.stages[0], []
    def step(iteration):
        made = stage.step(iteration)
        if iteration == at and spoil == "loss":
            made.loss = made.loss * torch.inf
        if iteration == at and spoil == "gradient":
            made.render.image.register_hook(lambda grad: grad * torch.inf)
        trainer.losses.append(made.loss.detach())
        return made
    trainer.stages[0] = stage._replace(step=step)
    return trainer

def error_of(method, spoil, at, **more):
    trainer = trainer_of(method, spoil, at)
    try:
        train(trainer, **{name: lambda log: call(trainer) for name, call in more.items()})
    except NonFiniteError as error:
        return [error.iteration, error.tensor.split()[0], len(trainer.losses)]

with costs:
    for method, spoil, iterations in (("3dgs", "loss", (1, 5, 7)), ("msmg", "gradient", (7,))):
        late[f"{method} {spoil}"] = [error_of(method, spoil, at) for at in iterations]
    late["checkpoint"] = error_of("3dgs", "gradient", 7, after_iteration=lambda trainer: trainer.state_dict())
    late["before update"] = error_of("3dgs", "loss", 7, before_update=lambda trainer: None)
    late["other error"] = error_of("3dgs", "gradient", 7, after_iteration=lambda t: 1 / (7 - len(t.losses)))

    trainer = trainer_of("3dgs")
    trainer.stopping = Plateau(PlateauRule(epochs=1, patience=1, gain=0.9, after=10), views=5)
    log = train(trainer)
    losses = [loss.item() for loss in trainer.losses]
    late["plateau"], late["lines"] = log.iterations, [line.loss == losses[line.iteration - 1] for line in log.lines]

    trainer = trainer_of("3dgs")
    trainer.stopping = Reader()
    late["rule"] = train(trainer).iterations
    assert trainer.stopping.losses == [loss.item() for loss in trainer.losses]
    assert all(type(loss) is float for loss in trainer.stopping.losses)
"""
STEPS = """
for method in sys.argv[2:]:
    steps[method] = steps_of(method, scene, costs)
    steps[f"{method}, masked"] = steps_of(method, masked_scene(scene), costs)
print(json.dumps({"noticed": noticed, "late": late, "steps": steps}), flush=True)
os._exit(0)  # autograd's thread of this device may abort while the interpreter ends
"""


def test_an_error_that_is_read_late_has_its_own_iteration(found):
    """[iteration, tensor, steps that were rendered]: one more than that iteration, unless something needs it before."""
    assert found["late"] == {
        "3dgs loss": [[1, "loss", 1], [5, "loss", 5], [7, "loss", 8]],
        "msmg gradient": [[7, "gradient", 8]],
        "checkpoint": [7, "gradient", 7],
        "before update": [7, "loss", 7],
        "other error": [7, "gradient", 7],
        "plateau": 20,
        "lines": [True] * 5,
        "rule": 4,
    }
