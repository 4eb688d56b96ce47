"""Rasterization backends, found by the names of their modules."""

from __future__ import annotations

import importlib
import pkgutil

import torch

from tdgbench.splats.backends.backend import Backend

ON_GPU = ("warp", "cuda")  # fast backends for float32 on a CUDA GPU, the preferred one first
FAST = {"cpu": ("cpu",), "cuda": ON_GPU}  # by the type of the device


def backend_names() -> list[str]:
    """Return the names of all backends.

    >>> set(backend_names()) >= {"cpu", "cuda", "reference"}
    True
    """
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if module.name != "backend")


def fast_backends() -> list[str]:
    """Return the names of the backends that can run on this machine, but for `reference`."""
    return [name for name in backend_names() if name != "reference" and load_backend(name).why_not() is None]


def load_backend(name: str) -> Backend:
    """Return the backend of a name. Raises ValueError if there is none."""
    module = f"{__name__}.{name}"
    try:
        return importlib.import_module(module).BACKEND
    except (ModuleNotFoundError, AttributeError) as error:
        if getattr(error, "name", module) not in (module, "BACKEND"):
            raise
        raise ValueError(f"backend is {name!r}; it must be one of auto, {', '.join(backend_names())}") from None


def choose_backend(name: str, device: torch.device, dtype: torch.dtype) -> str:
    """Return the name of the backend that renders tensors of a device and type.

    `auto` is for float32 tensors `cpu` on the CPU, and on a CUDA GPU the first of `ON_GPU` that can run; for all others
    it is `reference`. Raises ValueError if the backend does not take such tensors, RuntimeError if it cannot run on
    this machine.

    >>> [choose_backend("auto", torch.device("cpu"), dtype) for dtype in (torch.float32, torch.float64)]
    ['cpu', 'reference']
    """
    if name == "auto":
        fast = _fast(device, dtype)
        if not fast:
            return "reference"
        name = next((name for name in fast if load_backend(name).why_not() is None), fast[-1])
    backend = load_backend(name)
    if not backend.takes(device, dtype):
        raise ValueError(f"backend {name} takes {backend.inputs}, not {dtype} on {device}; use 'reference'")
    reason = backend.why_not()
    if reason is not None:
        raise RuntimeError(f"backend {name} cannot run: {reason}")
    return name


def backend_for(tensor: torch.Tensor) -> Backend:
    """Return the fast backend that takes tensors like this one and can run here, or else `reference`.

    It owns memory, statistics of density control, Adam's steps and losses of a training. Another backend may render
    the training: two backends that are compared differ in their rendering alone.
    """
    for name in _fast(tensor.device, tensor.dtype):
        backend = load_backend(name)
        if backend.why_not() is None:
            return backend
    return load_backend("reference")


def _fast(device: torch.device, dtype: torch.dtype) -> tuple[str, ...]:
    """Return the names of the fast backends for tensors of a device and type, the preferred one first."""
    return FAST.get(device.type, ()) if dtype == torch.float32 else ()
