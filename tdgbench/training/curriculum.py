"""The training views of each iteration and their resolution.

The resolution is low at first, if the spectrum of the images allows it (DashGaussian).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.scenes import View
from tdgbench.scenes.images import nearest_valid, resize
from tdgbench.training.budget import SCALES, PixelRule
from tdgbench.training.images import Modality
from tdgbench.training.part import Part, Report, State
from tdgbench.training.spectrum import noise_of, significant_amplitudes

MOSTLY = 0.5


class Curriculum(Part):
    """Chooses the training views of an iteration and their scale. Without steps and held-out views: all, full size.

    The resolution follows the schedule; `advance` moves to the next one earlier.
    """

    def __init__(self, steps: list[tuple[int, int]] | None = None, held_out: list[View] | None = None) -> None:
        """steps: (last iteration, scale) of each resolution below the full one. held_out: not trained on at first."""
        self.steps = steps or []
        self.held_out = held_out or []
        self.is_holding = bool(self.held_out)
        self._names = {view.name for view in self.held_out}
        self._step = 0  # in use; len(steps): the full resolution
        self.settled_at = 0  # the last iteration before the tail; 0: there is none yet
        self.has_ended = False  # after the tail: the model is trained no more
        self._shrunk: dict[str, View] = {}
        self._iteration = 0
        self._trained = [0] * (len(self.steps) + 1)  # iterations at each step

    def begin(self, iteration: int) -> None:
        """Set the resolution of an iteration (1-based)."""
        self._iteration = iteration
        step = self._step
        while not self.settled_at and step < len(self.steps) and iteration > self.steps[step][0]:
            step += 1
        self._use(step)
        self._trained[self._step] += not self.has_ended

    def advance(self) -> None:
        """Go on to the next resolution."""
        self._use(min(self._step + 1, len(self.steps)))

    def settle(self, scale: int) -> None:
        """Train on the held-out views as well from now on, at a fixed scale."""
        self.is_holding, self.settled_at = False, max(1, self._iteration)
        self._use([*(size for _, size in self.steps), 1].index(scale))

    def _use(self, step: int) -> None:
        if step != self._step:
            self._step, self._shrunk = step, {}

    @property
    def scale(self) -> int:
        """Images have 1/scale of their width and height now."""
        return self.steps[self._step][1] if self._step < len(self.steps) else 1

    @property
    def is_at_full_resolution(self) -> bool:
        """Whether images have all their pixels now."""
        return self._step == len(self.steps)

    @property
    def iterations(self) -> dict[int, int]:
        """Iterations trained so far by scale, the largest scale first."""
        return dict(zip((*(scale for _, scale in self.steps), 1), self._trained, strict=True))

    def shows(self, view: View) -> bool:
        """Return whether a view is trained on."""
        return not (self.is_holding and view.name in self._names)

    def at_resolution(self, view: View) -> View:
        """Return the view at the current resolution."""
        if self.is_at_full_resolution:
            return view
        if view.name not in self._shrunk:
            self._shrunk[view.name] = shrunk(view, self.scale)
        return self._shrunk[view.name]

    def state_dict(self) -> State:
        return {
            "step": self._step, "settled_at": self.settled_at, "is_holding": self.is_holding,
            "iteration": self._iteration, "trained": list(self._trained), "has_ended": self.has_ended,
        }  # fmt: skip

    def load_state_dict(self, saved: State) -> None:
        self.settled_at, self.is_holding, self.has_ended = (saved[n] for n in ("settled_at", "is_holding", "has_ended"))
        self._iteration, self._trained = saved["iteration"], list(saved["trained"])
        self._use(saved["step"])

    def report(self) -> Report:
        by_scale = {f"1/{scale}": count for scale, count in self.iterations.items()}
        return {"iterations": by_scale, "held_out": len(self.held_out), "settled_at": self.settled_at}


def schedule(
    rule: PixelRule, views: list[View], modality: Modality, gaussians: int, iterations: int
) -> list[tuple[int, int]]:
    """Return the steps (last iteration, scale) of `Curriculum`, for the images of a modality.

    gaussians: their number at the start. Images with fewer pixels than Gaussians save little time.
    """
    side = min(min(view.camera.width, view.camera.height) for view in views)
    pixels = min(view.camera.width * view.camera.height for view in views)
    scales = tuple(
        s for s in SCALES
        if s == 1 or (s <= rule.largest_scale and side // s >= rule.smallest_side and pixels >= gaussians * s**2)
    )  # fmt: skip
    amplitudes = []  # without masked pixels
    for view in views:
        image, valid = modality.array(view), modality.valid(view)
        amplitudes.append(significant_amplitudes(nearest_valid(image, valid), noise_of(image, valid), scales))
    shares = np.mean(amplitudes, axis=0)
    ends = [int(share * rule.until * iterations) for share in shares]
    return [(end, scale) for end, scale in zip(ends, scales, strict=True) if scale > 1 and end > 0]


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
