"""Scores of rendered views in one of the two conventions, and why a score is not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tdgbench.scenes import Scene, View
from tdgbench.scoring.backbones import BackboneUnavailableError
from tdgbench.scoring.geometry import depth_abs_rel, depth_consistency, floater_share
from tdgbench.scoring.lpips import LPIPS, Net, Range
from tdgbench.scoring.psnr import channel_psnr, psnr
from tdgbench.scoring.ssim import Border, ssim

METRICS = (
    "psnr", "ssim", "lpips", "channel_psnr", "rgb_psnr", "rgb_ssim", "rgb_lpips", "mae_degC", "depth_abs_rel",
    "floaters", "depth_consistency",
)  # fmt: skip
TRAIN_METRICS = ("psnr", "ssim")


@dataclass(frozen=True)
class RenderedImages:
    """What a method shows of one view.

    image: (H, W, C) float32, not clipped. depth: (H, W) expected z, 0 where nothing was rendered. rgb: (H, W, 3)
    float32 of the method's RGB model, None where it trains none.
    """

    image: np.ndarray
    depth: np.ndarray
    rgb: np.ndarray | None = None


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

    def score(self, scene: Scene, renders: Mapping[str, RenderedImages]) -> dict[str, dict[str, float | None]]:
        """All metrics of each test view by name; None where one does not apply (the reason is in `missing`)."""
        return {view.name: self._score(scene, view, renders) for view in scene.test}

    def _score(self, scene: Scene, view: View, renders: Mapping[str, RenderedImages]) -> dict[str, float | None]:
        rendered = renders[view.name]
        image, target = _as_saved(rendered.image), _as_saved(view.thermal)
        return {
            **self._cheap(image, target),
            "lpips": self.lpips(image, target),
            "channel_psnr": channel_psnr(rendered.image, view.thermal),
            **self._rgb(view, rendered),
            "mae_degC": self._mae_degC(scene, image, target),
            **self._depth_against_truth(view, rendered.depth),
            "depth_consistency": self._depth_consistency(scene, view, renders),
        }

    def score_train(self, view: View, rendered: RenderedImages) -> dict[str, float | None]:
        """PSNR and SSIM alone, which tell a training view's score from a test view's well enough."""
        return self._cheap(_as_saved(rendered.image), _as_saved(view.thermal))

    def _cheap(self, image: np.ndarray, target: np.ndarray) -> dict[str, float | None]:
        return {"psnr": psnr(image, target), "ssim": ssim(image, target, self.ssim_border)}

    def _rgb(self, view: View, rendered: RenderedImages) -> dict[str, float | None]:
        names = ("rgb_psnr", "rgb_ssim", "rgb_lpips")
        if rendered.rgb is None or view.load_rgb is None:
            reason = "the method trains no RGB model" if rendered.rgb is None else "a test view has no RGB image"
            self.missing |= dict.fromkeys(names, reason)
            return dict.fromkeys(names)
        image, target = _as_saved(rendered.rgb), _as_saved(view.rgb)
        lpips = self.lpips(image, target)
        if lpips is None:
            self.missing["rgb_lpips"] = self.missing["lpips"]
        return {f"rgb_{name}": v for name, v in {**self._cheap(image, target), "lpips": lpips}.items()}

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

    def _depth_against_truth(self, view: View, depth: np.ndarray) -> dict[str, float | None]:
        names, reason = ("depth_abs_rel", "floaters"), ""
        if view.true_depth is None:
            reason = "the scene has no true depth"
        elif view.true_depth.shape != depth.shape:
            reason = "the true depth has another size than the images"
        if reason or view.true_depth is None:
            self.missing |= dict.fromkeys(names, reason)
            return dict.fromkeys(names)
        truth = view.true_depth.astype(np.float64)
        return {"depth_abs_rel": depth_abs_rel(depth, truth), "floaters": floater_share(depth, truth)}

    def _depth_consistency(self, scene: Scene, view: View, renders: Mapping[str, RenderedImages]) -> float | None:
        """Against the nearest other test view."""
        others = [other for other in scene.test if other.name != view.name]
        if not others:
            self.missing["depth_consistency"] = "the scene has one test view"
            return None
        nearest = min(others, key=lambda other: float(np.linalg.norm(other.camera.center - view.camera.center)))
        found = depth_consistency(
            renders[view.name].depth, view.camera, renders[nearest.name].depth, nearest.camera
        )  # fmt: skip
        if found is None:
            self.missing["depth_consistency"] = f"view {view.name} and its neighbour hardly overlap"
        return found


def _as_saved(image: np.ndarray) -> np.ndarray:
    """An image as its 8-bit file gives it back, float32 in [0, 1]."""
    return to_8bit(image).astype(np.float32) / np.float32(255)


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
