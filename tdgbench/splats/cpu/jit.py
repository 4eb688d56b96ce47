"""How the CPU kernels are compiled: one decorator, one instruction set, one cache on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
from numba import njit

from tdgbench.splats.cpu.cache import open_cache, use_cache

# Fast-math without reassociation: float sums keep the order in which they are written, so that results do not
# depend on how the compiler unrolls, and the exp2 rounding trick survives.
FASTMATH = {"nsz", "arcp", "contract", "afn", "nnan"}


def lanes() -> int:
    """Return the number of float lanes of one SIMD register: 16 with AVX-512, else 8 (LLVM splits it on SSE and NEON).

    The environment variable TDGBENCH_LANES (8 or 16) forces a width, for tests.
    """
    forced = os.environ.get("TDGBENCH_LANES")
    if forced is not None:
        if forced not in ("8", "16"):
            raise ValueError(f"TDGBENCH_LANES is {forced!r}; it must be 8 or 16")
        return int(forced)
    return 16 if llvm.get_host_cpu_features().get("avx512f") else 8


CACHE_DIR = open_cache(lanes())


def kernel(
    inline: bool = False, free_sums: bool = False, variant: str = "", allocates: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function to machine code that runs without the GIL.

    inline: a helper that kernels call (a call from Python crashes); it counts no references to arrays, which would cost
    atomic operations in inner loops, unless it `allocates`. free_sums: sums may be reordered, and so vectorised; for
    kernels whose sums run over one row, so that results still do not depend on the number of threads. variant: name of
    one of several kernels made from the same source; each has separate files in the cache. Its closure may hold numbers
    only: Numba hashes it to find the machine code, and a function in it hashes differently in every process.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        if variant:
            function.__qualname__ += f".{variant}"
        fastmath = FASTMATH | {"reassoc"} if free_sums else FASTMATH
        options: dict[str, Any] = {
            "fastmath": fastmath,
            "error_model": "numpy",
            "boundscheck": False,
            "nogil": True,
            "no_cfunc_wrapper": True,
        }
        if inline:
            return njit(forceinline=True, _nrt=allocates, no_cpython_wrapper=True, **options)(function)
        compiled = njit(**options)(function)
        use_cache(compiled, CACHE_DIR)
        return compiled

    return decorate
