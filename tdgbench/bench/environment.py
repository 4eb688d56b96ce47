"""Environment of a result: versions, processor, GPU, commit."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tdgbench import __version__
from tdgbench.bench.commit import HASHED, ROOT, git_state
from tdgbench.bench.machine import describe_gpu, first_line_of, proc_field
from tdgbench.splats.backends.backend import installed_version
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.simd.registers import LANES

PACKAGES = (
    "tdgbench", "torch", "numpy", "numba", "scipy", "pycolmap", "lpips", "hydra-core", "pillow", "onnxruntime",
    "diffusers", "transformers", "gsplat", "warp-lang",
)  # fmt: skip
SAME_BYTES = ("python", "packages", "platform", "cpu", "simd_lanes", "gpu")  # decide a training's bytes; threads do not


def describe_environment(cells_at_once: int | None = 1) -> dict[str, object]:
    """Return machine and software, for the record. cells_at_once: of the sweep; None where a queue decides."""
    return {
        "python": platform.python_version(),
        "packages": {name: installed_version(name) for name in PACKAGES} | {"tdgbench": __version__},
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": pool.get_threads(),
        "cells_at_once": cells_at_once,
        "simd_lanes": LANES,
        "gpu": describe_gpu(),
        "git": git_state(),
    }


def code_version(config: object = None) -> str:
    """Return the hash of the sources that a result depends on: our own, and those of a configuration's plug-ins."""
    digest = hashlib.sha256(_own_code())
    for path in sorted(set(_plug_in_files(config))):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _own_code() -> bytes:
    digest = hashlib.sha256()
    for name in HASHED:
        place = ROOT / name
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.digest()


def _plug_in_files(config: object) -> Iterator[Path]:
    """Yield the modules of a configuration's plug-ins that are neither tdgbench's own nor an installed package's."""
    if isinstance(config, dict):
        known = [ROOT / "tdgbench", ROOT / "methods", *(Path(sysconfig.get_path(n)) for n in ("purelib", "stdlib"))]
        extra = config.get("extra")  # of `metrics`
        for name in [config.get("_target_", ""), *(extra if isinstance(extra, list) else ())]:
            file = getattr(sys.modules.get(str(name).rpartition(".")[0]), "__file__", None)
            if file is not None and not any(Path(file).is_relative_to(folder) for folder in known):
                yield Path(file)
        for value in config.values():
            yield from _plug_in_files(value)


@cache
def cpu_model() -> str:
    """Return the name of the processor, as precise as the platform gives it."""
    if sys.platform == "darwin":  # where `platform` says `arm` of all of Apple's
        return first_line_of("sysctl", "-n", "machdep.cpu.brand_string") or platform.machine()
    return proc_field(Path("/proc/cpuinfo"), "model name") or platform.processor() or platform.machine()
