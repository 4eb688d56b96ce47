"""Recorded scores against views.csv, and both against what the stored pictures and models give."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from tdgbench.cells.folder import RENDERS, TARGETS, CellFolder
from tdgbench.cells.ground_truth import masked_share
from tdgbench.cells.known_classes import extra_of
from tdgbench.cells.metric_settings import metric_settings, scorer_of
from tdgbench.cells.paths import RECORD_FILE, VIEWS_FILE
from tdgbench.cells.record import Record
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, RenderedImages, Scores, mean_scores
from tdgbench.scoring.backbones import BackboneUnavailableError
from tdgbench.scoring.metric import ImageMetric, Metric, MetricError
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView
from tdgbench.verify.problems import NotMade

TOLERANCE = 1e-6  # of means


def mean_problems(record: Record, rows: dict[str, Scores]) -> Iterator[str]:
    """Yield recorded scores that are not the means of views.csv, and scores that are n/a without a reason."""
    columns = {metric for row in rows.values() for metric in row}
    yield from (f"{VIEWS_FILE} has no column {metric}" for metric in record.scores if metric not in columns)
    unknown = sorted(columns - set(record.scores))
    yield from (f"{RECORD_FILE}: scores lacks {metric}, which {VIEWS_FILE} has" for metric in unknown)
    means = mean_scores(rows, record.scores)
    for metric, recorded in record.scores.items():
        mean = means[metric]
        if recorded is None and mean is None:
            if not record.missing.get(metric):
                yield f"{RECORD_FILE}: {metric} is n/a without a reason"
        elif not _is_close(recorded, mean):
            yield f"{RECORD_FILE}: {metric} is {_text(recorded)}, the mean of {VIEWS_FILE} is {_text(mean)}"


def mask_problems(cell: CellFolder) -> Iterator[str]:
    """Yield a share of masked test pixels that is not that of the stored masks. (Training views' are not stored.)"""
    found = masked_share(cell.view(name) for name in cell.test_cameras)
    recorded = cell.record.masked.get("test", 0.0)
    if not _is_close(found, recorded):
        yield f"{RECORD_FILE}: masked.test is {recorded}, the cell's masks give {found}"


def score_problems(
    cell: CellFolder, rows: dict[str, Scores] | None, depths: Mapping[str, np.ndarray | None], weights: Path | None
) -> Iterator[str]:
    """Yield scores that differ from those of the stored pictures and models.

    depths: (H, W) by view, of views that could be rendered. weights: file of LPIPS's backbone, for records of a file of
    their own; nothing is downloaded. Metrics with `verified_to` are computed again. n/a is a problem where the files
    alone give a value; it is none where only weights of a backbone were missing.
    """
    record, views = cell.record, list(cell.test_cameras)
    extra: list[str] = []
    try:
        extra = extra_of(record.setting("metrics"))
    except ValueError as error:
        yield str(error)
    scorer = scorer_of(metric_settings(record.setting("metrics")), weights=weights, extra=extra)
    convention, known = scorer.settings, scorer.metrics.values()
    metrics = [one for one in known if one.verified_to is not None and one.name in record.scores]
    if len(depths) < len(views):  # reported elsewhere; neighbours and depths are not known
        metrics = [metric for metric in metrics if isinstance(metric, ImageMetric)]
    computed: dict[str, list[float]] = {metric.name: [] for metric in metrics}
    scene = cell.scene()
    for view in views:
        try:
            shown = _shown(cell, depths, scene, view, convention)
        except ValueError as error:
            yield str(error)
            continue
        row = None if rows is None else rows.get(view)
        for metric in metrics:
            value = yield from _view_problems(metric, shown, row, record.scores[metric.name])
            if value is not None:
                computed[metric.name].append(value)
    for metric in metrics:
        mean = float(np.mean(computed[metric.name])) if len(computed[metric.name]) == len(views) > 0 else None
        recorded = record.scores[metric.name]
        if mean is not None and not _is_verified(metric, mean, recorded):
            yield f"{RECORD_FILE}: {metric.name} is {_text(recorded)}, the pictures give {mean:.6f}"


def _view_problems(
    metric: Metric, shown: ScoredView, row: Scores | None, recorded: float | None
) -> Generator[str, None, float | None]:
    """Yield problems of a metric in one view; return its value from the files, None if they give none.

    row: the view's, of views.csv. recorded: mean over the views.
    """
    stored = recorded if row is None else row.get(metric.name)
    if stored is None:  # whether the files give it without weights, which may not have been there
        bare = Convention(shown.convention.ssim_border, partial(_unusable, "no weights"))
        shown = ScoredView(shown.view, shown.rendered, bare, shown.scene, shown.renders)
    try:
        value = metric.score(shown)
    except Exception as error:  # a metric of the user may raise anything
        if metric.name in METRICS and not isinstance(error, NotApplicableError | MetricError):
            raise
        if stored is not None:
            yield NotMade(f"{metric.name} cannot be computed again: {error}")
        return None
    if row is not None and not _is_verified(metric, value, stored):
        name = shown.view.name
        yield f"{VIEWS_FILE}: {metric.name} of {name} is {_text(stored)}, its pictures give {value:.6f}"
    return value


def _unusable(why: str, image: np.ndarray, target: np.ndarray) -> float:
    raise BackboneUnavailableError(why)


def _shown(
    cell: CellFolder, depths: Mapping[str, np.ndarray | None], scene: Scene, name: str, convention: Convention
) -> ScoredView:
    """Return a test view with its stored pictures and all views' depths. Raises ValueError for an unusable picture."""
    nothing = np.zeros((0, 0, 1), np.float32)
    renders = {other: RenderedImages(nothing, depth) for other, depth in depths.items()}
    camera = cell.test_cameras[name]
    depth = depths.get(name, np.zeros((camera.height, camera.width), np.float32))
    view, rendered = cell.view(name), cell.rendered(name, depth)
    if view.thermal.shape != rendered.image.shape:
        shapes = view.thermal.shape, rendered.image.shape
        raise ValueError(f"{TARGETS}/{name}.png is {shapes[0]}, {RENDERS}/{name}.png {shapes[1]}")
    return ScoredView(view, rendered, convention, scene, renders)


def _is_verified(metric: Metric, value: float, stated: float | None) -> bool:
    """Return whether a stated score is the value that the files give, as exactly as the metric can be verified."""
    return stated is not None and abs(value - stated) <= (metric.verified_to or 0.0) * max(1.0, abs(stated))


def _is_close(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def _text(value: float | None) -> str:
    return "n/a" if value is None else str(value)
