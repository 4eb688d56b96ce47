"""Scores of rendered views in one of the two conventions, and the reasons for missing scores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tdgbench.scenes import Scene, View
from tdgbench.scoring.backbones import BackboneUnavailableError
from tdgbench.scoring.lpips import LPIPS, Net, Range
from tdgbench.scoring.metric import Metric
from tdgbench.scoring.registry import METRICS, TRAIN_METRICS
from tdgbench.scoring.scored_view import (
    Border,
    Convention,
    ConventionName,
    NotApplicableError,
    RenderedImages,
    ScoredView,
)


@dataclass(frozen=True)
class LPIPSOptions:
    """The LPIPS network and the source of its backbone (weights: a pth or npz file; None: torch's cache)."""

    net: Net
    weights: str | None
    download: bool


class Scorer:
    """Scores 8-bit renders against 8-bit targets, as published tables do.

    ssim_border and lpips_range make the convention: `3dgs` (zero, unit) or `standard` (valid, signed).
    """

    def __init__(
        self, convention: ConventionName, ssim_border: Border, lpips_range: Range, lpips: LPIPSOptions
    ) -> None:
        self.convention: str = convention
        self.settings = Convention(ssim_border, self.lpips)
        self.lpips_range: Range = lpips_range
        self.lpips_options = lpips
        self.missing: dict[str, str] = {}  # metric → why it is n/a

    def score(self, scene: Scene, renders: Mapping[str, RenderedImages]) -> dict[str, dict[str, float | None]]:
        """All metrics of each test view by name; None where one does not apply (the reason is in `missing`)."""

        def shown(view: View) -> ScoredView:
            return ScoredView(view, renders[view.name], self.settings, scene, renders)

        return {view.name: self._score(shown(view), METRICS.values()) for view in scene.test}

    def score_train(self, view: View, rendered: RenderedImages) -> dict[str, float | None]:
        """The cheap metrics of a training view, which suffice to show overfitting."""
        return self._score(ScoredView(view, rendered, self.settings), TRAIN_METRICS.values())

    def _score(self, shown: ScoredView, metrics: Iterable[Metric]) -> dict[str, float | None]:
        scores: dict[str, float | None] = {}
        for metric in metrics:
            try:
                scores[metric.name] = metric.score(shown)
            except NotApplicableError as error:
                scores[metric.name], self.missing[metric.name] = None, str(error)
        return scores

    def lpips(self, image: np.ndarray, target: np.ndarray) -> float:
        """LPIPS of two images (H, W, C) in [0, 1]. Raises BackboneUnavailableError without a backbone."""
        if isinstance(self._lpips, BackboneUnavailableError):
            raise BackboneUnavailableError(str(self._lpips))
        return self._lpips(image, target)

    @cached_property
    def _lpips(self) -> LPIPS | BackboneUnavailableError:
        options = self.lpips_options
        try:
            return LPIPS(options.net, self.lpips_range, options.weights, options.download)
        except BackboneUnavailableError as error:
            return error


def mean_scores(
    views: Mapping[str, Mapping[str, float | None]], metrics: Iterable[str] = METRICS
) -> dict[str, float | None]:
    """Mean over the views of each metric; None where any view lacks it.

    >>> mean_scores({"a": {"psnr": 20.0, "lpips": 0.1}, "b": {"psnr": 30.0, "lpips": None}}, ["psnr", "lpips"])
    {'psnr': 25.0, 'lpips': None}
    """
    means: dict[str, float | None] = {}
    for metric in metrics:
        values = [scores.get(metric) for scores in views.values()]
        present = [v for v in values if v is not None]
        means[metric] = float(np.mean(present)) if values and len(present) == len(values) else None
    return means
