"""Rasterization backends, found by the names of their modules."""

from __future__ import annotations

import importlib
import pkgutil

import torch

from tdgbench.splats.backends.backend import Backend

AUTO = {"cpu": "cpu", "cuda": "cuda"}  # fast backend for float32, by type of device


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
    """Return the name of the backend for tensors of a device and type.

    `auto` is `cpu` or `cuda` for float32 tensors there, and `reference` for all others. Raises ValueError if the
    backend does not take such tensors, RuntimeError if it cannot run on this machine.

    >>> [choose_backend("auto", torch.device("cpu"), dtype) for dtype in (torch.float32, torch.float64)]
    ['cpu', 'reference']
    """
    if name == "auto":
        return AUTO.get(device.type, "reference") if dtype == torch.float32 else "reference"
    backend = load_backend(name)
    if not backend.takes(device, dtype):
        raise ValueError(f"backend {name} takes {backend.inputs}, not {dtype} on {device}; use 'reference'")
    reason = backend.why_not()
    if reason is not None:
        raise RuntimeError(f"backend {name} cannot run: {reason}")
    return name
