"""What every Gaussian carries through training: a row of parameters, its two moments, and when they were last moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT, padded
from tdgbench.splats.cpu.rows import permute_rows
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.gaussians import Gaussians

GROWTH = 3.0  # of the room, when it is used up; memory that was never written costs nothing
ORDER_AGAIN = 1.25  # times as many Gaussians as when they were last ordered in space
AXIS_BITS = 21
ROWS_AT_ONCE = 100_000  # that are worked on in double precision
ROWS = ("_values", "_first", "_second", "_bounds", "_clocks")  # all have one row per Gaussian, and room for more


class TrainingState:
    """N Gaussians as rows (N, columns): means, quats, log_scales, opacity_logits, then sh; each row whole cache lines.

    `first` and `second` are Adam's moments in the same layout. Room grows ahead of need, so that Gaussians come and go
    without copying the others.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        count, self.bases, self.channels = len(gaussians), *gaussians.sh.shape[1:]
        self.columns = COLORS_AT + self.bases * self.channels
        self.count = count
        like = gaussians.means.detach()
        shape = (max(count, 1), padded(self.columns))
        self._values, self._first, self._second = (_room(like, shape).zero_() for _ in range(3))
        self._clocks = torch.zeros(shape[0], 2, dtype=torch.int32, device=like.device)
        self.now = 0  # the optimiser's steps so far
        self.values[:] = self.rows_of(gaussians)
        self._bounds = _bounds_of(self._values)
        self.order_in_space()

    def __len__(self) -> int:
        return self.count

    @property
    def values(self) -> Tensor:
        """(N, columns) parameters."""
        return self._values[: self.count]

    @property
    def first(self) -> Tensor:
        return self._first[: self.count]

    @property
    def second(self) -> Tensor:
        return self._second[: self.count]

    @property
    def bounds(self) -> Tensor:
        """(N, 4): mean and largest log scale when a row was last moved, for culling."""
        return self._bounds[: self.count]

    @property
    def clocks(self) -> Tensor:
        """(N, 2) int32: the optimiser's step up to which moments and parameters are current."""
        return self._clocks[: self.count]

    def split(self, rows: Tensor) -> Gaussians:
        """Rows (n, columns) seen as the five tensors of Gaussians; they share memory and gradients."""
        return Gaussians(
            means=rows[:, MEANS_AT:QUATS_AT],
            log_scales=rows[:, SCALES_AT:OPACITY_AT],
            quats=rows[:, QUATS_AT:SCALES_AT],
            opacity_logits=rows[:, OPACITY_AT],
            sh=rows[:, COLORS_AT : self.columns].unflatten(1, (self.bases, self.channels)),
        )

    def rows_of(self, gaussians: Gaussians) -> Tensor:
        """Gaussians as rows of this layout."""
        rows = self._values.new_zeros(len(gaussians), self._values.shape[1])
        for part, given in zip(self.split(rows).items(), gaussians.items(), strict=True):
            part[1].copy_(given[1].detach())
        return rows

    def column_of(self, name: str) -> slice:
        """Where a parameter stands in a row."""
        ends = {
            "means": (MEANS_AT, QUATS_AT),
            "log_scales": (SCALES_AT, OPACITY_AT),
            "quats": (QUATS_AT, SCALES_AT),
            "opacity_logits": (OPACITY_AT, COLORS_AT),
            "sh": (COLORS_AT, self.columns),
        }[name]
        return slice(*ends)

    def exchange(self, removed: Tensor, added: Tensor) -> None:
        """Take away the rows at `removed` (ascending) and put in new ones (n, columns), whose moments are zero.

        All rows must be current. New rows take the places of removed ones first; then they go to the end, or rows from
        the end fill the places that are left.
        """
        gone, new = len(removed), len(added)
        self._make_room(self.count + max(new - gone, 0))
        end = self.count + new - gone
        places = torch.cat([removed[:new], torch.arange(self.count, max(end, self.count), device=removed.device)])
        for own, rows in ((self._values, added), (self._bounds, _bounds_of(added))):
            own[places] = rows
        for own in (self._first, self._second):
            own[places] = 0
        if end < self.count:
            holes = removed[new:]
            stays = torch.ones(self.count - end, dtype=torch.bool, device=holes.device)
            stays[holes[holes >= end] - end] = False
            last = stays.nonzero().squeeze(1) + end
            for own in (self._values, self._bounds, self._first, self._second):
                own[holes[holes < end]] = own[last]
        self.count = end
        self._clocks[:end] = self.now
        if self.count > ORDER_AGAIN * self._ordered_at:
            self.order_in_space()

    def order_in_space(self) -> None:
        """Put neighbours beside each other (along a Z-order curve): what a camera sees then lies in few places.

        All rows must be current.
        """
        order = _z_order(self.values[:, MEANS_AT:QUATS_AT])
        for own in (self._values, self._bounds, self._first, self._second):
            if own.device.type == "cpu" and own.dtype == torch.float32:
                permute_rows(own.numpy(), order.numpy())
            else:
                own[: self.count] = own[: self.count][order]
        self._ordered_at = self.count

    def state_dict(self) -> dict[str, Any]:
        """All rows as they lie there, lagging ones too; tensors on the CPU, which share memory where they can."""
        return {
            **{name: compact(getattr(self, name)[: self.count]) for name in ROWS},
            "now": self.now,
            "ordered_at": self._ordered_at,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave, for Gaussians of the same layout."""
        self.count = len(saved["_values"])
        for name in ROWS:
            room = _room(getattr(self, name), (max(self.count, 1), saved[name].shape[1]))
            room[: self.count] = saved[name]
            setattr(self, name, room)
        self.now, self._ordered_at = saved["now"], saved["ordered_at"]

    def _make_room(self, count: int) -> None:
        if count <= len(self._values):
            return
        room = int(count * GROWTH)
        for name in ROWS:
            old = getattr(self, name)
            larger = _room(old, (room, old.shape[1]))
            larger[: self.count] = old[: self.count]
            setattr(self, name, larger)
            del old, larger


def compact(tensor: Tensor) -> Tensor:
    """A tensor on the CPU whose storage holds itself alone, as `torch.save` writes whole storages."""
    return torch.from_numpy(tensor.detach().cpu().numpy())


def _room(like: Tensor, shape: tuple[int, int]) -> Tensor:
    """An uninitialised tensor of a type and device; on the CPU in memory as the kernels want it."""
    if like.device.type == "cpu" and like.dtype == torch.float32:
        return torch.from_numpy(empty_aligned(shape, np.float32))
    return like.new_empty(shape)


def _z_order(means: Tensor) -> Tensor:
    """The order (N,) of points (N, 3) along a Z-order (Morton) curve through their bounding box."""
    points = means.detach().cpu().numpy()
    if not len(points):
        return torch.zeros(0, dtype=torch.int64, device=means.device)
    pieces = [slice(start, start + ROWS_AT_ONCE) for start in range(0, len(points), ROWS_AT_ONCE)]
    low = np.min([_finite(points[piece]).min(axis=0) for piece in pieces], axis=0)
    high = np.max([_finite(points[piece]).max(axis=0) for piece in pieces], axis=0)
    scale = (2**AXIS_BITS - 1) / max((high - low).max(), 1e-300)
    code = np.zeros(len(points), np.uint64)
    for piece in pieces:
        cells = (_finite(points[piece]) - low) * scale
        for axis in range(3):
            bits = cells[:, axis].astype(np.uint64)
            for shift, mask in _SPREAD:
                bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
            code[piece] |= bits << np.uint64(axis)
    return torch.from_numpy(np.argsort(code, kind="stable")).to(means.device)


def _finite(points: np.ndarray) -> np.ndarray:
    """Points as float64, NaN as 0 and infinities as the largest numbers."""
    return np.nan_to_num(points.astype(np.float64))


# Steps that put two zero bits between the bits of a 21-bit number.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _bounds_of(rows: Tensor) -> Tensor:
    return torch.cat([rows[:, MEANS_AT:QUATS_AT], rows[:, SCALES_AT:OPACITY_AT].amax(dim=1, keepdim=True)], dim=1)
