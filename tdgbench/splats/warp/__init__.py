"""Kernels of the `warp` backend, a file per stage: one source for CUDA and for the CPU device of NVIDIA Warp."""

import importlib.util
from functools import cache


@cache
def import_problem(on_gpu: bool) -> str | None:
    """Return why Warp cannot be imported, or does not run on the GPU that torch found; None if it can be used."""
    if importlib.util.find_spec("warp") is None:
        return "warp-lang is not installed: pip install -e '.[warp]'"
    try:
        import warp

        import tdgbench.splats.warp.arrays  # noqa: F401, sets Warp up
    except Exception as error:  # of another package of this name, too
        return f"warp-lang cannot be imported ({type(error).__name__}: {(str(error).splitlines() or [''])[0]})"
    if on_gpu and not warp.is_cuda_available():
        return (
            f"the NVIDIA driver is too old for warp-lang {warp.__version__}: its wheel on PyPI is built for CUDA "
            "13 and needs driver 580 or newer; update the driver, or install NVIDIA's wheel for CUDA 12"
        )
    return None
