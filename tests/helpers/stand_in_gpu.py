"""A stand-in for a GPU in torch and Warp: its memory is the host's, but it counts what a real one has to do.

`steps_of` trains on it by backend `warp`. It changes torch for its process: install it in a new one.
"""

from __future__ import annotations

import os
from collections import Counter
from contextlib import nullcontext, suppress

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map_only

from tdgbench.scenes import Scene

NAME = "stand_in"
READS = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "is_nonzero", "_unique2", "unique_dim")
VIEWS = (
    "detach", "alias", "view", "_unsafe_view", "reshape", "expand", "slice", "select", "split", "split_with_sizes",
    "unbind", "t", "transpose", "permute", "squeeze", "unsqueeze", "unflatten", "narrow", "empty", "new_empty",
    "empty_like", "_reshape_alias", "set_",
)  # fmt: skip


class OnDevice(torch.Tensor):
    """A tensor of the stand-in. raw: the tensor of the host that holds its memory."""

    raw: torch.Tensor

    @staticmethod
    def __new__(cls, raw: torch.Tensor) -> OnDevice:
        made = torch.Tensor._make_wrapper_subclass(
            cls, raw.size(), strides=raw.stride(), dtype=raw.dtype, device=torch.device(NAME, 0)
        )
        made.raw = raw
        return made

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        raise RuntimeError(f"{function} on the stand-in, without its `Costs`")

    def numpy(self, *, force=False):
        return self.cpu().numpy()

    def tolist(self):
        return self.cpu().tolist()


class Costs(TorchDispatchMode):
    """Runs operations of the stand-in, and counts: launches; waits of the host, by operation; copies to and fro."""

    def __init__(self) -> None:
        super().__init__()
        self.pinned: set[int] = set()
        self.waits = Counter[str]()
        self.waits_before = 0  # the last `clear`
        self.clear()

    @property
    def all_waits(self) -> int:
        """Number of waits so far; at each, the device has finished all that it was asked for."""
        return self.waits_before + self.waits.total()

    def clear(self) -> None:
        self.waits_before = self.all_waits
        self.launches, self.to_device, self.to_host = 0, 0, 0
        self.waits = Counter[str]()

    def read(self) -> dict:
        """Return the counts since the last call."""
        waits = {name: count for name, count in self.waits.items() if count}
        found = {"launches": self.launches, "waits": waits, "to_device": self.to_device, "to_host": self.to_host}
        self.clear()
        return found

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        given = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, torch.Tensor)]
        is_here = any(isinstance(t, OnDevice) for t in given)
        device = kwargs.get("device")
        stays = is_here if device is None else torch.device(device).type == NAME
        name = function.name().split("::")[1].split(".")[0]
        if is_here or stays:
            self._count(name, given, stays, kwargs)
        if device is not None:
            kwargs["device"] = "cpu"
        host_args, host_kwargs = tree_map_only(OnDevice, lambda t: t.raw, (args, kwargs))
        host_kwargs.pop("non_blocking", None)
        result = function(*host_args, **host_kwargs)
        if not stays or name == "_local_scalar_dense":
            return result
        return args[0] if name.endswith("_") else tree_map_only(torch.Tensor, OnDevice, result)

    def _count(self, name: str, given: list[torch.Tensor], stays: bool, kwargs: dict) -> None:
        from_host = [t for t in given if not isinstance(t, OnDevice) and t.dim()]
        if name in ("_to_copy", "copy_") and (from_host or not stays):
            # torch pins the memory to which it copies from a device without a wait
            waits = not kwargs.get("non_blocking") or (stays and from_host[0].data_ptr() not in self.pinned)
            self.to_device, self.to_host = self.to_device + stays, self.to_host + (not stays)
            self.waits[f"{name} {'to the device' if stays else 'to the host'}"] += waits
        elif name in READS:
            self.waits[name] += 1
        elif name in ("index", "index_put_", "index_put") and any(t.dtype == torch.bool for t in given[1:]):
            # torch's index_put_ of one number in the places of a mask is a masked_fill
            self.waits["indexing by a mask"] += not (name != "index" and given[-1].numel() == 1 and len(given) == 3)
        elif name not in VIEWS:
            self.launches += 1


def event_class(costs: Costs) -> type:
    """Return what stands in for `torch.cuda.Event`."""

    class Event:
        def record(self, stream: None) -> None:
            self.recorded_after = costs.all_waits

        def synchronize(self) -> None:
            costs.waits["event"] += costs.all_waits == self.recorded_after

    return Event


def install(costs: Costs) -> None:
    """Make torch know the device, and backend `warp` and its kernels train on it."""
    from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

    _setup_privateuseone_for_python_backend(NAME)

    import warp as wp

    from tdgbench.splats import backends
    from tdgbench.splats.backends.warp import WarpBackend
    from tdgbench.splats.warp import arrays, losses, passes, training

    def pin(tensor: torch.Tensor) -> torch.Tensor:
        costs.pinned.add(tensor.data_ptr())
        return tensor

    of_host, launch, launch_tiled = arrays.array, wp.launch, wp.launch_tiled

    def array(tensor, dtype=None):
        return of_host(tensor.raw if isinstance(tensor, OnDevice) else tensor, dtype)

    def counted(function):
        def run(*args, **kwargs):
            costs.launches += 1
            if "device" in kwargs:
                kwargs["device"] = "cpu"
            return function(*args, **kwargs)

        return run

    torch.Tensor.pin_memory = pin  # type: ignore[method-assign, assignment]
    torch.cuda.Event = event_class(costs)  # type: ignore[misc, assignment]
    torch.cuda.current_stream = lambda device=None: None  # type: ignore[assignment, return-value]
    wp.launch, wp.launch_tiled = counted(launch), counted(launch_tiled)
    wp.utils.array_scan, wp.utils.radix_sort_pairs = map(counted, (wp.utils.array_scan, wp.utils.radix_sort_pairs))
    for module in (arrays, passes, training, losses):
        module.array, module.on_stream = array, lambda device: nullcontext()
    backends.FAST[NAME] = ("warp",)
    os.environ["TDGBENCH_WARP_LANES"] = "1"
    WarpBackend.device = NAME  # type: ignore[assignment, method-assign]
    WarpBackend.takes = lambda self, device, dtype: True  # type: ignore[method-assign]


def steps_of(method: str, scene: Scene, costs: Costs) -> list[dict]:
    """Train for two rounds of the views; return what each step of the last one cost, if it wrote no log line.

    Density control observes, and changes nothing.
    """
    from tdgbench.training.loop import train
    from tests.helpers.training import ready_to_train

    number = len(scene.train)
    with costs:
        trainer = ready_to_train(scene, method, 1000, "backend=warp", "budget.density.start=500")
        found: list[dict] = []

        def note(log) -> None:
            logs = bool(log.lines) and log.lines[-1].iteration == log.iterations
            found.append({**costs.read(), "logs": logs})
            if log.iterations == 2 * number:
                raise KeyboardInterrupt

        with suppress(KeyboardInterrupt):
            train(trainer, after_iteration=note)
    return [step for step in found[number:] if not step.pop("logs")]
