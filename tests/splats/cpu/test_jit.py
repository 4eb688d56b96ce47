import subprocess
import sys

import pytest

from tdgbench.children import with_path
from tdgbench.splats.cpu import jit
from tests.helpers.paths import ROOT


def test_lanes_can_be_forced(monkeypatch):
    monkeypatch.setenv("TDGBENCH_LANES", "8")
    assert jit.lanes() == 8
    monkeypatch.setenv("TDGBENCH_LANES", "12")
    with pytest.raises(ValueError, match="TDGBENCH_LANES is '12'"):
        jit.lanes()


# Forward and backward.
RENDER = """
from tdgbench.splats import rasterization
from tests.helpers.gaussians import random_gaussians, turned_camera

leaves = [p.requires_grad_() for p in random_gaussians(50, 0, None, 1)]
image = rasterization(*leaves, *turned_camera(20, 20), 20, 20)[0]
image.sum().backward()
total = image.double().sum().item() + sum(p.grad.double().sum().item() for p in leaves)
"""
# The bits of a gradient, of four small kernels; two of them may reorder sums.
GRADIENT = """
import hashlib
import torch
from tdgbench.splats.cpu.losses.minmax import min_max

a, b = torch.rand(2, 61, 83, generator=torch.Generator().manual_seed(0))
min_max(a.requires_grad_()).backward(b)
total = hashlib.sha256(a.grad.numpy().tobytes()).hexdigest()
"""
# Prints the sum, and the hits and misses of the cache over all kernels called.
COUNT = """
import gc
from numba.core.dispatcher import Dispatcher

kernels = [k for k in gc.get_objects() if isinstance(k, Dispatcher) and k.signatures and k.stats.cache_path]
hits, misses = (sum(sum(getattr(k.stats, name).values()) for k in kernels) for name in ("cache_hits", "cache_misses"))
print(total, hits, misses)
"""


def test_a_second_process_compiles_nothing():
    """What this process has compiled, the next one loads."""
    exec(RENDER, {})
    env = with_path(ROOT)
    run = subprocess.run([sys.executable, "-c", RENDER + COUNT], env=env, capture_output=True, text=True, timeout=1200)
    _, hits, misses = run.stdout.split()
    assert int(hits) > 5 and int(misses) == 0


def test_a_sum_has_the_same_bits_whether_its_kernel_was_compiled_or_loaded(tmp_path):
    env = {**with_path(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    call = [sys.executable, "-c", GRADIENT + COUNT]
    runs = [subprocess.run(call, env=env, capture_output=True, text=True, timeout=1200) for _ in range(2)]
    (total, _, compiled), (again, loaded, misses) = (run.stdout.split() for run in runs)
    assert total == again and int(compiled) == int(loaded) > 1 and int(misses) == 0
