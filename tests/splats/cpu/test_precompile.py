import subprocess
import sys

from tdgbench.children import with_path
from tdgbench.splats.cpu import jit, pool
from tdgbench.splats.cpu.precompile import compiled_alongside
from tests.helpers.paths import ROOT

# The precompiled kernels must have the argument types of training, or they are compiled twice.
SAME_TYPES = """
import torch
from hydra.utils import instantiate
from tdgbench.splats.cpu.losses.photometric import photometric_band
from tdgbench.splats.cpu.precompile import compile_last_kernels
from tdgbench.splats.cpu.raster.blend import make_blend
from tdgbench.splats.cpu.raster.blend_backward import make_blend_backward
from tdgbench.splats.cpu.raster.projection_backward import projection_backward
from tdgbench.training.warmup import compile_kernels
from tests.helpers.configs import config

budget = instantiate(config("budget=demo").budget)
compile_kernels({1}, budget, "cpu", depth=False)
of_depth = [len(kernel.signatures) for kernel in (make_blend(1, True), make_blend_backward(1, True, False))]
compile_last_kernels(["1", "depth"])
compile_kernels({1}, budget, "cpu")
kernels = [projection_backward]
for depth in (False, True):
    kernels += [make_blend(1, depth), make_blend_backward(1, depth, False)]
compile_kernels({1}, budget, "cpu", masked=True)
kinds = {str(signature[3]) for signature in photometric_band.signatures}
print(of_depth, [len(kernel.signatures) for kernel in kernels], len(kinds), sum("none" in kind for kind in kinds))
"""


def test_what_is_compiled_is_what_training_calls():
    run = subprocess.run(
        [sys.executable, "-c", SAME_TYPES], cwd=ROOT, env=with_path(ROOT), text=True,
        capture_output=True, timeout=600,
    )  # fmt: skip
    assert run.stdout.strip() == "[1, 0] [1, 1, 1, 1, 1] 2 1", run.stderr[-2000:]


def test_it_is_done_once(monkeypatch, tmp_path):
    started = []

    class Helper:
        def __init__(self, command, **_):
            started.append(command)
            (tmp_path / "kernels").mkdir(exist_ok=True)

        def wait(self):
            return 0

        def kill(self):
            pass

    monkeypatch.setattr(subprocess, "Popen", Helper)
    monkeypatch.setattr(jit, "CACHE_DIR", tmp_path / "kernels")
    monkeypatch.setattr(pool, "available_cores", lambda: 2)
    for channels in ({1}, {1}, {3, 1}, {1, 3}):
        with compiled_alongside(channels, depth=False):
            pass
    with compiled_alongside({1}, depth=True):
        pass
    assert [command[3:] for command in started] == [["1"], ["1", "3"], ["1", "depth"]]
    monkeypatch.setattr(pool, "available_cores", lambda: 1)
    with compiled_alongside({3}, depth=True):
        pass
    assert len(started) == 3
