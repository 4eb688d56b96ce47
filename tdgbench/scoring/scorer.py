"""Scores of rendered views in one of the two conventions, and the reasons for missing scores."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from traceback import extract_tb
from typing import Annotated, Any, TypeVar

import numpy as np
import torch
from pydantic import AfterValidator

from tdgbench.scenes import Scene, View
from tdgbench.scoring.backbones import BackboneUnavailableError, Net
from tdgbench.scoring.lpips import LPIPS, Range
from tdgbench.scoring.metric import FAILED, Metric, MetricError
from tdgbench.scoring.registry import METRICS, extra_metrics, on_training_views, with_extra
from tdgbench.scoring.scored_view import (
    Border,
    Convention,
    ConventionName,
    NotApplicableError,
    RenderedImages,
    ScoredView,
)
from tdgbench.splats.cpu import pool

PIXELS_AT_ONCE = 8 * 640 * 480  # LPIPS with vgg takes up to 1 kB a pixel: 300 MB for a view of 640×480, 2.4 GB for 8

T = TypeVar("T")
R = TypeVar("R")
Scores = dict[str, float | None]  # by metric; None: it does not apply


class MetricFault(str):
    """Why a metric of the user is n/a, where that is a fault of its code."""


def _existing(file: str) -> str:
    """Raise ValueError for a file that is not there; else it would be missed only after a training."""
    if not Path(file).is_file():
        raise ValueError("there is no such file")
    return file


def _usable(extra: list[str]) -> list[str]:
    extra_metrics(extra)
    return extra


@dataclass(frozen=True)
class LPIPSOptions:
    """The LPIPS network and the source of its backbone (weights: a pth or npz file; None: torch's cache)."""

    net: Net
    weights: Annotated[str, AfterValidator(_existing)] | None  # checked as an option, not where records are read
    download: bool


class Scorer:
    """Scores 8-bit renders against 8-bit targets, as published tables do.

    ssim_border and lpips_range make the convention: `3dgs` (zero, unit) or `standard` (valid, signed). extra: metrics
    of the user, MODULE.NAME. Threads score a view each; the scores do not depend on their number.
    """

    def __init__(
        self,
        convention: ConventionName,
        ssim_border: Border,
        lpips_range: Range,
        lpips: LPIPSOptions,
        extra: Annotated[list[str], AfterValidator(_usable)] | None = None,
    ) -> None:
        self.convention: str = convention
        self.settings = Convention(ssim_border, self.lpips)
        self.lpips_range: Range = lpips_range
        self.lpips_options = lpips
        self.metrics = with_extra(extra or ())
        self.train_metrics = on_training_views(self.metrics)
        self.no_lpips = ""  # why no backbone may be read, if so
        self.missing: dict[str, str] = {}  # metric → why it is n/a

    def score(
        self, scene: Scene, renders: Mapping[str, RenderedImages], metrics: Sequence[Metric] | None = None
    ) -> dict[str, Scores]:
        """Return metrics, by default all, of each test view; None where one does not apply (`missing` says why)."""
        common: dict[str, Any] = {}

        def shown(view: View) -> ScoredView:
            return ScoredView(view, renders[view.name], self.settings, scene, renders, common)

        return self._scores(scene.test, shown, list(self.metrics.values()) if metrics is None else metrics)

    def score_train(self, views: Sequence[View], renders: Mapping[str, RenderedImages]) -> dict[str, Scores]:
        """Return the metrics that score training views, by view and name, to detect overfitting."""

        def shown(view: View) -> ScoredView:
            return ScoredView(view, renders[view.name], self.settings)

        return self._scores(views, shown, list(self.train_metrics.values()), prefix="train_")

    def _scores(
        self, views: Sequence[View], shown: Callable[[View], ScoredView], metrics: Sequence[Metric], prefix: str = ""
    ) -> dict[str, Scores]:
        """Return the scores by view, and add the reasons for missing ones to `missing`, by the metric's name."""
        if views and any(metric.of_network for metric in metrics):
            _ = self._lpips  # here, so that no two threads load the network
        largest = max((view.camera.width * view.camera.height for view in views), default=0)
        scored = map_views(lambda view: _scored(shown(view), metrics), views, largest)
        for _, missing in scored:
            self.missing |= {prefix + name: why for name, why in missing.items()}
        return {view.name: scores for view, (scores, _) in zip(views, scored, strict=True)}

    def lpips(self, image: np.ndarray, target: np.ndarray) -> float:
        """Return the LPIPS of two images (H, W, C) in [0, 1]. Raises BackboneUnavailableError without a backbone."""
        if isinstance(self._lpips, BackboneUnavailableError):
            raise BackboneUnavailableError(str(self._lpips))
        return self._lpips(image, target)

    @cached_property
    def _lpips(self) -> LPIPS | BackboneUnavailableError:
        options = self.lpips_options
        try:
            if self.no_lpips:
                raise BackboneUnavailableError(self.no_lpips)
            return LPIPS(options.net, self.lpips_range, options.weights, options.download)
        except BackboneUnavailableError as error:
            return error


def _scored(shown: ScoredView, metrics: Iterable[Metric]) -> tuple[Scores, dict[str, str]]:
    """Return the scores of a view, None where a metric does not apply or one of the user fails, and why."""
    scores: Scores = {}
    missing: dict[str, str] = {}
    for metric in metrics:
        try:
            scores[metric.name] = metric.score(shown)
        except NotApplicableError as error:
            scores[metric.name], missing[metric.name] = None, str(error)
        except Exception as error:  # the user's code may raise anything; it costs no training and no other score
            if metric.name in METRICS or isinstance(error, MemoryError):
                raise
            scores[metric.name], missing[metric.name] = None, MetricFault(f"{FAILED}{_in_words(error)}")
    return scores, missing


def _in_words(error: Exception) -> str:
    """Return what a metric of the user raised, and where."""
    if isinstance(error, MetricError):
        return str(error)
    text = "; ".join([str(error), *getattr(error, "__notes__", ())])
    own = [frame for frame in extract_tb(error.__traceback__) if "site-packages" not in frame.filename]
    return f"{type(error).__name__}: {text} ({Path(own[-1].filename).name}, line {own[-1].lineno})"


def mean_scores(views: Mapping[str, Scores], metrics: Iterable[str] | None = None) -> Scores:
    """Return the mean over the views of each metric, by default those of the first view; None where any view lacks it.

    >>> mean_scores({"a": {"psnr": 20.0, "lpips": 0.1}, "b": {"psnr": 30.0, "lpips": None}})
    {'psnr': 25.0, 'lpips': None}
    """
    means: Scores = {}
    for metric in next(iter(views.values()), METRICS) if metrics is None else metrics:
        values = [scores.get(metric) for scores in views.values()]
        present = [v for v in values if v is not None]
        means[metric] = float(np.mean(present)) if values and len(present) == len(values) else None
    return means


def map_views(function: Callable[[T], R], views: Sequence[T], pixels: int) -> list[R]:
    """Apply a function to views in parallel and return the results in their order.

    pixels: of the largest view; it limits the views in memory. torch uses one thread per view. An exception of the
    function is raised.
    """
    in_memory = max(1, PIXELS_AT_ONCE // max(1, pixels))
    workers = max(1, min(in_memory, pool.get_threads(), len(views)))
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as executor:
            return list(executor.map(function, views))
    finally:
        torch.set_num_threads(before)
