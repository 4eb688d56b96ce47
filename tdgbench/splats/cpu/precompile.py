"""Compile the last kernels of a training step in a second process, while the first step compiles the others.

Numba compiles one kernel at a time in a process. The second process calls its kernels on empty arrays and writes their
machine code to the cache. The order does not matter: each process compiles the kernels that the cache lacks.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tdgbench.splats.blending import AS_3DGS
from tdgbench.splats.cpu import jit, pool
from tdgbench.splats.cpu.raster.limits import pack_limits
from tdgbench.splats.cpu.raster.passes import ForwardPass, Projected, Settings, Source, backward, blend
from tdgbench.splats.cpu.raster.projection import CAMERA_SIZE
from tdgbench.splats.cpu.raster.records import RECORD
from tdgbench.splats.cpu.scratch import Lease

ROOT = Path(__file__).resolve().parents[3]


@contextmanager
def compiled_alongside(channels: set[int]) -> Iterator[None]:
    """Context in which a second process compiles, if there is a second core and the cache is not complete."""
    done = jit.CACHE_DIR / f"compiled-{'-'.join(map(str, sorted(channels)))}"
    if done.exists() or pool.available_cores() < 2:
        yield
        return
    command = [sys.executable, "-m", "tdgbench.splats.cpu.precompile", *map(str, sorted(channels))]
    helper = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
        helper.wait()  # so that it does not slow the training down, which is timed
        done.touch()
    finally:
        helper.kill()
        helper.wait()


def compile_late_kernels(channels: list[int]) -> None:
    """Compile the kernels that a training step calls last. channels: of the images, 1 or 3."""
    for colors in sorted(channels, reverse=True):
        for depth in (True, False):
            blend_nothing(colors, depth)


def blend_nothing(colors: int, depth: bool) -> None:
    """Call both passes of the blend for `colors` channels, and the backward projection, on empty arrays."""
    nothing = np.empty(0, np.float32)
    settings = Settings(
        camera=np.zeros(CAMERA_SIZE, np.float32), width=0, height=0, degree=0, depth_channel=depth,
        background=np.zeros(colors, np.float32), limits=pack_limits(AS_3DGS),
    )  # fmt: skip
    source = Source(
        count=0, arrays=(nothing,) * 5, layout=np.zeros(10, np.int64), raw=True, sizes=(nothing, 0, 0, 0),
        centres=(nothing, 0, 0),
    )  # fmt: skip
    records, indices, starts = np.empty((0, RECORD), np.float32), np.empty(0, np.int32), np.zeros(1, np.int64)
    lit = np.empty(0, np.uint32)
    image, depth_map, transmittance, reached = blend(settings, records, starts, indices, lit)
    done = ForwardPass(
        image, depth_map, transmittance, Projected([], indices, indices, np.empty((0, 2), np.float32)), records,
        owners=indices, pairs=np.empty((0, 2), np.int32), kept=[(0, 0)], pair_room=0, tile_start=starts,
        gaussian_of=indices, slot_of=indices, reached=reached, lit=lit, lease=Lease(),
    )  # fmt: skip
    backward(source, settings, done, None, None, None)


if __name__ == "__main__":
    compile_late_kernels([int(count) for count in sys.argv[1:]])
