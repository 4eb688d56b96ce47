"""Compile kernels in a second process while the first step of a training compiles others.

Numba compiles one kernel at a time in a process. The second process calls the kernels that a training reaches last,
with nothing to do, and leaves their machine code in the cache. Whichever process reaches a kernel first compiles it;
others wait for it.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from tdgbench.splats.cpu import jit, pool
from tdgbench.splats.cpu.raster.blend import blend_tiles
from tdgbench.splats.cpu.raster.passes import blend_backward
from tdgbench.splats.cpu.raster.types import (
    FLOATS,
    ForwardPass,
    Projected,
    Settings,
    Splats,
    TileLists,
    pack_camera,
    pack_limits,
    plain_channels,
    source_of_rows,
)
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.gaussians import COLORS_AT, padded
from tdgbench.splats.view import AS_3DGS

ROOT = Path(__file__).resolve().parents[3]


@contextmanager
def compiled_alongside(channels: set[int], depth: bool) -> Iterator[None]:
    """Compile in a second process during the block, if there is a core for it and the cache lacks the kernels.

    channels: numbers of colour channels that the training renders. depth: its loss takes rendered depth, too.
    """
    kinds = [*map(str, sorted(channels)), *["depth"] * depth]
    done = jit.CACHE_DIR / f"compiled-{'-'.join(kinds)}"
    if done.exists() or pool.available_cores() < 2:
        yield
        return
    command = [sys.executable, "-m", "tdgbench.splats.cpu.precompile", *kinds]
    helper = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
        helper.wait()  # it would disturb the training's clock
        with suppress(OSError):
            done.touch()
    finally:
        helper.kill()
        helper.wait()


def compile_last_kernels(kinds: list[str]) -> None:
    """Compile the kernels that a training reaches last, the last ones first: of numbers of channels and `depth`."""
    for colors in sorted((int(kind) for kind in kinds if kind.isdigit()), reverse=True):
        for depth in (True, False):  # held-out views are rendered with their depth in any case
            blend_nothing(colors, depth, backward="depth" in kinds or not depth)


def blend_nothing(colors: int, depth: bool, backward: bool) -> None:
    """Run the blend, and if asked for its backward pass and that of the projection, without pixels and Gaussians."""
    camera = pack_camera(np.eye(4), np.eye(3), 0, 0, 1.0, 1.0, 0.0)
    channels = plain_channels(colors, 0, depth)
    settings = Settings(camera, 0, 0, channels, np.zeros(colors, np.float32), pack_limits(AS_3DGS))
    rows = np.empty((0, padded(COLORS_AT + colors)), np.float32)
    source = source_of_rows(rows, np.empty((0, 4), np.float32), 0.0, 0.0)
    ids, pairs = np.empty(0, np.int32), np.empty((0, 2), np.int32)
    splats = Splats(np.empty((0, FLOATS), np.float32), ids, pairs, np.empty(0, np.uint32))
    tiles = TileLists(np.zeros(1, np.int64), ids, ids)
    images, visits = blend_tiles(settings, splats, tiles, np.empty(0, np.uint32))
    projected = Projected(ids, ids, np.empty((0, 2), np.float32))
    view = ForwardPass(images, projected, [], splats, [(0, 0)], tiles, visits, pair_capacity=0, workspace=Workspace())
    if backward:
        blend_backward(source, settings, view, None, None, None).compute()


if __name__ == "__main__":
    compile_last_kernels(sys.argv[1:])
