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

# Of one set of Gaussians: pairs of its view, then loss, and flags of its gradients that are not finite.
READS = {
    "3dgs": {"_local_scalar_dense": 1, "_to_copy to the host": 2},
    "tdg": {"_local_scalar_dense": 1, "_to_copy to the host": 2},
    "msmg": {"_local_scalar_dense": 2, "_to_copy to the host": 3},
}
MOST_LAUNCHES = {"3dgs": 67, "tdg": 199, "msmg": 186}  # with a mask


def run(*call: str) -> dict:
    environment = {**os.environ, "CUDA_VISIBLE_DEVICES": ""}  # one accelerator is enough
    done = subprocess.run(
        [sys.executable, *call], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_a_step_waits_for_pairs_loss_and_flags_alone(data_root):
    """With active density control, with and without masks; rates are one copy without a wait per set of Gaussians."""
    found = run("-m", "tests.helpers.stand_in_gpu", str(data_root), *READS)
    assert len(found) == 2 * len(READS)
    for name, steps in found.items():
        method = name.split(",")[0]
        assert len(steps) >= 5
        for step in steps:
            assert step["waits"] == READS[method], name
            assert step["to_device"] == READS[method]["_local_scalar_dense"]
            assert 40 < step["launches"] <= MOST_LAUNCHES[method], name


NOTICED = """
import json, torch
from tests.helpers.stand_in_gpu import NAME, Costs, install
costs, found = Costs(), {}
install(costs)
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
        "pageable": lambda: host.to(NAME, non_blocking=True),
        "pinned": lambda: pinned.to(NAME, non_blocking=True),
        "on the device": lambda: torch.where(mask, x, 0.0).index_add_(0, torch.arange(6, device=NAME), x),
    }.items():
        costs.clear()
        call()
        found[name] = sum(costs.waits.values())
    assert x.cpu().tolist() == [1.0] * 6
print(json.dumps(found))
"""


def test_the_stand_in_notices_what_makes_a_host_wait():
    without = {"pinned": 0, "on the device": 0}
    found = run("-c", NOTICED)
    assert {name: found.pop(name) for name in without} == without
    assert set(found.values()) == {1}, found
