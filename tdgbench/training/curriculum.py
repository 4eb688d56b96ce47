"""The training views of each iteration and their resolution: low at first, and without held-out views, if rules say so.

Which resolutions there are is decided by `tdgbench.training.pixels`, which views are held out by
`tdgbench.training.settling`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.scenes import View
from tdgbench.scenes.images import resize
from tdgbench.training.part import Json, Part, Report, State

MOSTLY = 0.5


class Resolution(NamedTuple):
    """A resolution below the full one."""

    last: int  # iteration, by the schedule
    scale: int  # images have 1/scale of their width and height


class Curriculum(Part):
    """Chooses the training views of an iteration and their scale; by default all of them, at full size.

    The resolution follows the schedule; `advance` moves to the next one earlier.
    """

    changing = ("_step", "settled_at", "tail", "is_holding", "_iteration", "_trained", "has_ended", "checks", "reason")

    def __init__(self, resolutions: list[Resolution] | None = None, held_out: list[View] | None = None) -> None:
        """resolutions: below the full one, the lowest first. held_out: views that are not trained on at first."""
        self.resolutions = resolutions or []
        self.held_out = held_out or []
        self.is_holding = bool(self.held_out)
        self._names = {view.name for view in self.held_out}
        self._scales = [*(resolution.scale for resolution in self.resolutions), 1]
        self._step = 0  # the resolution in use; that after the last one is the full one
        self.settled_at = 0  # the last iteration before the tail; 0: there is none yet
        self.tail = 0  # iterations after it
        self.checks: list[list[float]] = []  # of held-out views: iteration, scale, mean PSNR in dB
        self.reason = ""  # why it settled
        self.has_ended = False  # after the tail: the model is trained no more
        self._shrunk: dict[str, View] = {}
        self._iteration = 0
        self._trained = [0] * (len(self.resolutions) + 1)  # iterations at each resolution

    def begin(self, iteration: int) -> None:
        """Set the resolution of an iteration (1-based)."""
        self._iteration = iteration
        step = self._step
        while not self.settled_at and step < len(self.resolutions) and iteration > self.resolutions[step].last:
            step += 1
        self._use(step)
        self._trained[self._step] += not self.has_ended

    def advance(self) -> None:
        """Go on to the next resolution."""
        self._use(min(self._step + 1, len(self.resolutions)))

    def settle(self, scale: int, tail: float, reason: str = "") -> None:
        """Train on the held-out views as well from now on, at a fixed scale. tail: share of the iterations so far."""
        self.is_holding, self.settled_at, self.reason = False, max(1, self._iteration), reason
        self.tail = max(1, round(tail * self.settled_at))
        self._use(self._scales.index(scale))

    def _use(self, step: int) -> None:
        if step != self._step:
            self._step, self._shrunk = step, {}

    @property
    def scale(self) -> int:
        """Images have 1/scale of their width and height now."""
        return self._scales[self._step]

    @property
    def is_at_full_resolution(self) -> bool:
        """Whether images have all their pixels now."""
        return self._step == len(self.resolutions)

    @property
    def iterations(self) -> dict[int, int]:
        """Iterations trained so far by scale, the largest scale first."""
        return dict(zip(self._scales, self._trained, strict=True))

    def shows(self, view: View) -> bool:
        """Return whether a view is trained on."""
        return not (self.is_holding and self.was_held_out(view))

    def was_held_out(self, view: View) -> bool:
        """Return whether a view is one of those that were not trained on at first."""
        return view.name in self._names

    def at_resolution(self, view: View) -> View:
        """Return the view at the current resolution."""
        if self.is_at_full_resolution:
            return view
        if view.name not in self._shrunk:
            self._shrunk[view.name] = shrunk(view, self.scale)
        return self._shrunk[view.name]

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        self._shrunk = {}

    def report(self) -> Report:
        by_scale = {f"1/{scale}": count for scale, count in self.iterations.items()}
        report: dict[str, Json] = {
            "iterations": by_scale,
            "held_out": len(self.held_out),
            "settled_at": self.settled_at,
            "checks": self.checks,
            "reason": self.reason,
        }
        return {name: value for name, value in report.items() if value != [] and value != ""}


def evenly_spread(views: list[View], count: int) -> list[View]:
    """Return a number of views at even distances in their order.

    >>> evenly_spread(list(range(40)), 4)
    [5, 15, 25, 35]
    """
    return [views[int((i + 0.5) * len(views) / count)] for i in range(count)]


def shrunk(view: View, scale: int) -> View:
    """Return a view with 1/scale of the width and height; each pixel is the mean of the valid pixels in its area.

    A pixel is valid if half of its area is; if there is no such pixel, the most valid ones are.
    """
    width, height = (max(1, round(side / scale)) for side in (view.camera.width, view.camera.height))
    images = {"load_thermal": _loader(resize(view.thermal, width, height)), "load_valid": None}
    if view.valid is not None:
        share = resize(view.valid[..., None].astype(np.float32), width, height)
        valid = share[..., 0] >= min(MOSTLY, float(share.max()))
        means = resize(view.thermal, width, height) / np.maximum(share, 1e-6)  # masked pixels are 0
        images = {
            "load_thermal": _loader(np.where(valid[..., None], means, np.float32(0))),
            "load_valid": _loader(valid),
        }
    load_rgb = None if view.load_rgb is None else lambda: resize(view.rgb, width, height)
    return replace(view, camera=view.camera.resized(width, height), load_rgb=load_rgb, **images)  # type: ignore[arg-type]


def _loader(array: np.ndarray):
    return lambda: array
