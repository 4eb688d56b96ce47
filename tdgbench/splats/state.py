"""Memory of a training: for each Gaussian a row of parameters, Adam's two moments, culling bounds and clocks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.backends import backend_for
from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.gaussians import LEAST_COLUMNS, MEANS_AT, SCALES_AT, Gaussians
from tdgbench.splats.gradients import RowArrays

MEANS, SCALES = slice(MEANS_AT, MEANS_AT + 3), slice(SCALES_AT, SCALES_AT + 3)
REORDER_AT = 1.25  # times as many Gaussians as when they were last ordered in space
AXIS_BITS = 21
CHUNK_ROWS = 100_000  # converted to double precision at once
COLUMNS_AT_ONCE = 4  # that are reordered
ROWS = ("_values", "_first", "_second", "_bounds", "_clocks")  # arrays with one row per Gaussian


class TrainingState:
    """N Gaussians as rows (N, columns): means, quats, log_scales, opacity_logits, sh, others, one after the other.

    `first` and `second` are Adam's moments in the same layout. The arrays have spare capacity, so that Gaussians can be
    added and removed without copying the others.
    """

    def __init__(self, gaussians: Gaussians, backend: Backend | None = None) -> None:
        """backend: owner of memory, steps and statistics; by default the fast one for the tensors (`backend_for`)."""
        self.count, self.channels = len(gaussians), gaussians.channels
        self._places = _places_of(gaussians)
        self.columns = max(at.stop for at, _ in self._places.values())
        self._arrays: RowArrays | None = None  # of the current rows
        like = gaussians.means.detach()
        self.backend = backend or backend_for(like)
        shape = (max(self.count, 1), max(self.columns, LEAST_COLUMNS))
        self._values, self._first, self._second = (self.backend.new_rows(like, shape, zeros=True) for _ in range(3))
        self._clocks = torch.zeros(shape[0], 2, dtype=torch.int32, device=like.device)
        self.now = 0  # steps of the optimiser so far
        self._write(gaussians, self.values)
        self._bounds = _bounds_of(self._values)
        self._order_in_space(self._values, self._bounds)  # zeros that are not moved take no memory

    def __len__(self) -> int:
        return self.count

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_arrays": None}  # those of a copy share the memory of its own tensors

    @property
    def values(self) -> Tensor:
        """(N, columns) parameters."""
        return self._values[: self.count]

    @property
    def first(self) -> Tensor:
        """(N, columns) first moments."""
        return self._first[: self.count]

    @property
    def second(self) -> Tensor:
        """(N, columns) second moments."""
        return self._second[: self.count]

    @property
    def bounds(self) -> Tensor:
        """(N, 4): mean (world units) and largest log scale at the last step with a gradient, or flush; for culling."""
        return self._bounds[: self.count]

    @property
    def clocks(self) -> Tensor:
        """(N, 2) int32: steps up to which moments and parameters are current."""
        return self._clocks[: self.count]

    def arrays(self) -> RowArrays:
        """Return the rows as NumPy arrays, which share the memory of float32 rows on the CPU."""
        if self._arrays is None:
            tensors = (self.values, self.first, self.second, self.bounds, self.clocks)
            self._arrays = RowArrays(*(tensor.numpy() for tensor in tensors))
        return self._arrays

    def split(self, rows: Tensor) -> Gaussians:
        """Return rows (n, columns) as Gaussians; they share memory and gradients."""
        sizes = [at.stop - at.start for at, _ in self._places.values()]
        # One split for all: its backward pass is one concatenation, where each slice's would fill all columns.
        parts = rows.split([*sizes, rows.shape[1] - sum(sizes)], dim=1)
        fields = {name: part.unflatten(1, at[1]) for (name, at), part in zip(self._places.items(), parts, strict=False)}
        parameters = {name: fields.pop(name) for name in Gaussians.names()}
        parameters["opacity_logits"] = parameters["opacity_logits"].squeeze(1)
        return Gaussians(**parameters, extra_fields=fields)

    def rows_of(self, gaussians: Gaussians) -> Tensor:
        """Convert Gaussians to new rows (n, columns)."""
        rows = self._values.new_zeros(len(gaussians), self._values.shape[1])
        self._write(gaussians, rows)
        return rows

    def _write(self, gaussians: Gaussians, rows: Tensor) -> None:
        """Write Gaussians to rows (n, columns)."""
        for part, given in zip(self.split(rows).items(), gaussians.items(), strict=True):
            part[1].copy_(given[1].detach().reshape(part[1].shape))

    def columns_of(self, name: str) -> slice:
        """Return the columns of a parameter."""
        return self._places[name][0]

    def channels_of(self, name: str) -> int:
        """Return the length of the last axis of a field: the channels of a colour set."""
        return self._places[name][1][-1]

    def replace_rows(self, removed: Tensor, added: Tensor) -> None:
        """Remove the rows at `removed` (n,), ascending, and add rows (m, columns) with zero moments.

        All rows must be current. Added rows take the places of removed ones; the rest is appended, or rows from the end
        fill the remaining places.
        """
        n_removed, n_added = len(removed), len(added)
        self._reserve(self.count + max(n_added - n_removed, 0))
        end = self.count + n_added - n_removed
        appended = torch.arange(self.count, max(end, self.count), device=removed.device)
        targets = torch.cat([removed[:n_added], appended])
        for array, rows in ((self._values, added), (self._bounds, _bounds_of(added))):
            array[targets] = rows
        for array in (self._first, self._second):
            array[targets] = 0
        if end < self.count:
            holes = removed[n_added:]
            stays = torch.ones(self.count - end, dtype=torch.bool, device=holes.device)
            stays[holes[holes >= end] - end] = False
            last = stays.nonzero().squeeze(1) + end
            for array in (self._values, self._bounds, self._first, self._second):
                array[holes[holes < end]] = array[last]
        self.count, self._arrays = end, None
        self._clocks[:end] = self.now
        if self.count > REORDER_AT * self._ordered_at:
            self._order_in_space(self._values, self._bounds, self._first, self._second)

    def _order_in_space(self, *arrays: Tensor) -> None:
        """Sort rows along a Z-order curve, so that the Gaussians of a view are close in memory; all must be current."""
        order = _z_order(self.values[:, MEANS])
        for array in arrays:
            for some in array.split(COLUMNS_AT_ONCE, dim=1):  # a copy of all would double the memory
                some[: self.count] = some.index_select(0, order)
        self._ordered_at = self.count

    def forget_moments(self) -> None:
        """Free the memory of both moments. All rows must be current; no step and no `state_dict` can follow."""
        self._first, self._second, self._arrays = self._first[:0].clone(), self._second[:0].clone(), None

    def refresh_bounds(self) -> None:
        """Let culling know that rows were changed from outside. All rows must be current."""
        self._bounds[: self.count] = _bounds_of(self.values)

    def state_dict(self) -> dict[str, Any]:
        """Return all rows, deferred steps not applied; the tensors share memory with the state where possible."""
        return {
            **{name: compact(getattr(self, name)[: self.count]) for name in ROWS},
            "now": self.now,
            "ordered_at": self._ordered_at,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, for Gaussians of the same layout."""
        self.count, self._arrays = len(saved["_values"]), None
        for name in ROWS:
            array = self.backend.new_rows(getattr(self, name), (max(self.count, 1), saved[name].shape[1]))
            array[: self.count] = saved[name]
            setattr(self, name, array)
        self.now, self._ordered_at = saved["now"], saved["ordered_at"]

    def _reserve(self, count: int) -> None:
        """Raise the capacity to `count` rows or more."""
        if count <= len(self._values):
            return
        capacity, self._arrays = int(count * self.backend.capacity_growth), None
        for name in ROWS:
            old = getattr(self, name)
            larger = self.backend.new_rows(old, (capacity, old.shape[1]))
            larger[: self.count] = old[: self.count]
            setattr(self, name, larger)
            del old, larger
            self.backend.free_memory()  # C's allocator may hold the old array: it is not always a mapping of its own


def _places_of(gaussians: Gaussians) -> dict[str, tuple[slice, tuple[int, ...]]]:
    """Return the columns of each field, and the shape of one Gaussian's value, in the order of the columns."""
    first, found = 0, dict[str, tuple[slice, tuple[int, ...]]]()
    names = ("means", "quats", "log_scales", "opacity_logits", "sh")
    for name, tensor in ({name: getattr(gaussians, name) for name in names} | gaussians.extra_fields).items():
        shape = tuple(tensor.shape[1:]) or (1,)
        found[name] = slice(first, first + math.prod(shape)), shape
        first += math.prod(shape)
    return found


def compact(tensor: Tensor) -> Tensor:
    """Return the tensor on the CPU in a storage of its size: `torch.save` writes whole storages."""
    return torch.from_numpy(tensor.detach().cpu().numpy())


def _z_order(means: Tensor) -> Tensor:
    """Return the order (N,) of points (N, 3) along a Z-order (Morton) curve through their bounding box."""
    points = means.detach().cpu().numpy()
    if not len(points):
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    chunks = [slice(start, start + CHUNK_ROWS) for start in range(0, len(points), CHUNK_ROWS)]
    low = np.min([_finite(points[chunk]).min(axis=0) for chunk in chunks], axis=0)
    high = np.max([_finite(points[chunk]).max(axis=0) for chunk in chunks], axis=0)
    scale = (2**AXIS_BITS - 1) / max((high - low).max(), 1e-300)
    code = np.zeros(len(points), np.uint64)
    for chunk in chunks:
        cells = (_finite(points[chunk]) - low) * scale
        for axis in range(3):
            bits = cells[:, axis].astype(np.uint64)
            for shift, mask in _SPREAD:
                bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
            code[chunk] |= bits << np.uint64(axis)
    return torch.from_numpy(np.argsort(code, kind="stable")).to(means.device)


def _finite(points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) as float64, with NaN as 0 and infinities as the largest numbers."""
    return np.nan_to_num(points.astype(np.float64))


# Shifts and masks that put two zero bits between the bits of a 21-bit number.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _bounds_of(rows: Tensor) -> Tensor:
    """Return bounds (n, 4) of rows (n, columns), see `TrainingState.bounds`."""
    return torch.cat([rows[:, MEANS], rows[:, SCALES].amax(dim=1, keepdim=True)], dim=1)
