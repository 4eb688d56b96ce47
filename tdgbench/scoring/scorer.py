"""Scores of rendered views in one of the two conventions, and why a score is not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tdgbench.scenes import Scene, View
from tdgbench.scoring.backbones import BackboneUnavailableError
from tdgbench.scoring.lpips import LPIPS, Net, Range
from tdgbench.scoring.psnr import psnr
from tdgbench.scoring.ssim import Border, ssim

METRICS = ("psnr", "ssim", "lpips", "mae_degC", "depth_abs_rel")
TRAIN_METRICS = ("psnr", "ssim")


@dataclass(frozen=True)
class LPIPSOptions:
    """Which LPIPS, and where its backbone comes from (weights: a pth or npz file; None: torch's cache)."""

    net: Net
    weights: str | None
    download: bool


def to_8bit(image: np.ndarray) -> np.ndarray:
    """What saving as an 8-bit image makes of values in [0, 1]: uint8, rounded half up."""
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


class Scorer:
    """Scores 8-bit renders against 8-bit targets, as published tables do.

    ssim_border and lpips_range make the convention: `3dgs` (zero, unit) or `standard` (valid, signed).
    """

    def __init__(self, convention: str, ssim_border: Border, lpips_range: Range, lpips: LPIPSOptions) -> None:
        self.convention = convention
        self.ssim_border: Border = ssim_border
        self.lpips_range: Range = lpips_range
        self.lpips_options = lpips
        self.missing: dict[str, str] = {}  # metric → why it is n/a

    @cached_property
    def _lpips(self) -> LPIPS | None:
        options = self.lpips_options
        try:
            return LPIPS(options.net, self.lpips_range, options.weights, options.download)
        except BackboneUnavailableError as error:
            self.missing["lpips"] = str(error)
            return None

    def score(self, scene: Scene, view: View, rendered: np.ndarray, depth: np.ndarray) -> dict[str, float | None]:
        """All metrics of one view; None where one does not apply (the reason is in `missing`).

        rendered: (H, W, C) uint8. depth: (H, W) expected z, 0 where nothing was rendered.
        """
        image, target = _pair(rendered, view)
        return {
            **self._cheap(image, target),
            "lpips": self.lpips(image, target),
            "mae_degC": self._mae_degC(scene, image, target),
            "depth_abs_rel": self._depth_abs_rel(view, depth),
        }

    def score_train(self, view: View, rendered: np.ndarray) -> dict[str, float | None]:
        """PSNR and SSIM alone, which tell a training view's score from a test view's well enough."""
        return self._cheap(*_pair(rendered, view))

    def _cheap(self, image: np.ndarray, target: np.ndarray) -> dict[str, float | None]:
        return {"psnr": psnr(image, target), "ssim": ssim(image, target, self.ssim_border)}

    def lpips(self, image: np.ndarray, target: np.ndarray) -> float | None:
        """LPIPS of two images (H, W, C) in [0, 1]; None without a backbone."""
        return None if self._lpips is None else self._lpips(image, target)

    def _mae_degC(self, scene: Scene, image: np.ndarray, target: np.ndarray) -> float | None:
        if scene.temperature is None:
            self.missing["mae_degC"] = "the scene has no temperature range (temperature.json)"
            return None
        if scene.channels != 1:
            self.missing["mae_degC"] = "the thermal images are pseudo-colour, which is not a linear temperature scale"
            return None
        span = scene.temperature.max - scene.temperature.min
        return float(np.abs(image - target).mean(dtype=np.float64) * span)

    def _depth_abs_rel(self, view: View, depth: np.ndarray) -> float | None:
        if view.true_depth is None:
            self.missing["depth_abs_rel"] = "the scene has no true depth"
            return None
        truth = view.true_depth.astype(np.float64)
        if truth.shape != depth.shape:
            self.missing["depth_abs_rel"] = "the true depth has another size than the images"
            return None
        return float((np.abs(depth - truth) / truth).mean())


def _pair(rendered: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """A render (uint8) and its view's thermal image as 8-bit images in [0, 1]."""
    return tuple(p.astype(np.float32) / np.float32(255) for p in (rendered, to_8bit(view.thermal)))  # type: ignore[return-value]


def mean_scores(
    views: Mapping[str, Mapping[str, float | None]], metrics: Sequence[str] = METRICS
) -> dict[str, float | None]:
    """Mean over the views of each metric; None where any view lacks it."""
    means: dict[str, float | None] = {}
    for metric in metrics:
        values = [scores.get(metric) for scores in views.values()]
        present = [v for v in values if v is not None]
        means[metric] = float(np.mean(present)) if values and len(present) == len(values) else None
    return means
