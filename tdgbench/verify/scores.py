"""Recorded scores against views.csv, and both against what the stored pictures and models give."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tdgbench.bench.scores import Row
from tdgbench.cells.masks import masked_share
from tdgbench.cells.metric_settings import metric_settings, scorer_of
from tdgbench.cells.record import FILE, Record
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, RenderedImages
from tdgbench.scoring.backbones import BackboneUnavailableError
from tdgbench.scoring.metric import ImageMetric, Metric
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView
from tdgbench.verify.pictures import StoredPictures

TOLERANCE = 1e-6  # of means


def mean_problems(record: Record, rows: dict[str, Row]) -> Iterator[str]:
    """Yield recorded scores that are not the means of views.csv, and scores that are n/a without a reason."""
    columns = {metric for row in rows.values() for metric in row}
    yield from (f"views.csv has no column {metric}" for metric in record.scores if metric not in columns)
    yield from (
        f"{FILE}: scores lacks {metric}, which views.csv has" for metric in sorted(columns - set(record.scores))
    )
    for metric, recorded in record.scores.items():
        values = [row[metric] for row in rows.values() if metric in row]
        known = [value for value in values if value is not None]
        mean = float(np.mean(known)) if known and len(known) == len(rows) else None
        if recorded is None and mean is None and not record.missing.get(metric):
            yield f"{FILE}: {metric} is n/a without a reason"
        elif (recorded is None) != (mean is None) or (None not in (recorded, mean) and not _close(recorded, mean)):
            yield f"{FILE}: {metric} is {_text(recorded)}, the mean of views.csv is {_text(mean)}"


def mask_problems(record: Record, pictures: StoredPictures) -> Iterator[str]:
    """Yield a share of masked test pixels that is not that of the stored masks. (Training views' are not stored.)"""
    found = masked_share(pictures.view(name) for name in pictures.cameras)
    recorded = record.masked.get("test", 0.0)
    if not _close(found, recorded):
        yield f"{FILE}: masked.test is {recorded}, the cell's masks give {found}"


def score_problems(
    record: Record, rows: dict[str, Row] | None, pictures: StoredPictures, weights: Path | None
) -> Iterator[str]:
    """Yield scores that differ from those of the stored pictures and models.

    weights: file of LPIPS's backbone, for records of a file of their own; nothing is downloaded.
    Metrics with `verified_to` are computed again. n/a is a problem where the files alone give a value; it is none where
    only weights of a backbone were missing.
    """
    convention = scorer_of(metric_settings(record.setting("metrics")), weights=weights).settings
    metrics = [one for one in METRICS.values() if one.verified_to is not None and one.name in record.scores]
    if len(pictures.depths) < len(pictures.cameras):  # reported elsewhere; neighbours and depths are not known
        metrics = [metric for metric in metrics if isinstance(metric, ImageMetric)]
    computed: dict[str, list[float]] = {metric.name: [] for metric in metrics}
    scene = pictures.scene()
    for name in pictures.cameras:
        try:
            shown = _shown(pictures, scene, name, convention)
        except ValueError as error:
            yield str(error)
            continue
        row = None if rows is None else rows.get(name)
        for metric in metrics:
            stored = record.scores[metric.name] if row is None else row.get(metric.name)
            value, problem = _again(metric, shown, stored)
            if problem:
                yield problem
            if value is not None:
                computed[metric.name].append(value)
                if row is not None and (stored is None or abs(value - stored) > _tolerance(metric, stored)):
                    yield f"views.csv: {metric.name} of {name} is {_text(stored)}, its pictures give {value:.6f}"
    for metric in metrics:
        values, recorded = computed[metric.name], record.scores[metric.name]
        if values and len(values) == len(pictures.cameras):
            mean = float(np.mean(values))
            if recorded is None or abs(mean - recorded) > _tolerance(metric, recorded):
                yield f"{FILE}: {metric.name} is {_text(recorded)}, the pictures give {mean:.6f}"


def _again(metric: Metric, shown: ScoredView, stored: float | None) -> tuple[float | None, str]:
    """Return the value of a metric from files or None, and a problem if a stored value cannot be computed again."""
    if stored is None:  # whether the files give it without weights, which may not have been there
        bare = Convention(shown.convention.ssim_border, partial(_unusable, "no weights"))
        shown = ScoredView(shown.view, shown.rendered, bare, shown.scene, shown.renders)
    try:
        return metric.score(shown), ""
    except NotApplicableError as error:
        return None, "" if stored is None else f"{metric.name} cannot be computed again: {error}"


def _unusable(why: str, image: np.ndarray, target: np.ndarray) -> float:
    raise BackboneUnavailableError(why)


def _shown(pictures: StoredPictures, scene: Scene, name: str, convention: Convention) -> ScoredView:
    """Return a test view with its stored pictures and all views' depths. Raises ValueError for an unusable picture."""
    nothing = np.zeros((0, 0, 1), np.float32)
    renders = {other: RenderedImages(nothing, depth) for other, depth in pictures.depths.items()}
    camera = pictures.cameras[name]
    depth = pictures.depths.get(name, np.zeros((camera.height, camera.width), np.float32))
    view, rendered = pictures.view(name), pictures.rendered(name, depth)
    if view.thermal.shape != rendered.image.shape:
        raise ValueError(f"targets/{name}.png is {view.thermal.shape}, renders/{name}.png {rendered.image.shape}")
    return ScoredView(view, rendered, convention, scene, renders)


def _tolerance(metric: Metric, value: float) -> float:
    return (metric.verified_to or 0.0) * max(1.0, abs(value))


def _close(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def _text(value: float | None) -> str:
    return "n/a" if value is None else str(value)
