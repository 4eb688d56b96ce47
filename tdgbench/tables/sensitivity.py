"""`tdgbench tables sensitivity DIR`: the stored renders scored by other conventions than the record's.

Papers seldom say how their scores were computed. This shows how far a choice moves the scores, and whether it changes
which method is better. A split or a value range cannot be changed without training, and is not among the choices.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple, get_args

import numpy as np
import pandas as pd
from skimage.metrics import structural_similarity

from tdgbench.cells.folder import TARGETS, CellFolder
from tdgbench.cells.metric_settings import metric_settings, why_no_lpips
from tdgbench.cells.record import Record
from tdgbench.scoring import METRICS, LPIPSOptions, Scorer
from tdgbench.scoring.backbones import Net
from tdgbench.scoring.lpips import Range
from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.metrics.psnr import channel_psnr, psnr_of
from tdgbench.scoring.metrics.psnr_fitted import psnr_affine
from tdgbench.scoring.scored_view import Border, Convention, ConventionName, ImagePair, NotApplicableError, at_valid
from tdgbench.tables.measures import MEASURES
from tdgbench.tables.results import Cell

COLUMNS = ["score", "convention", "cells", "mean_change", "largest_change", "pairs", "reversed", "other_best", "reason"]
RECORDED = "as recorded"  # the first choice of each score

Weights = Mapping[str, str]  # file by network
_NO_WEIGHTS: Weights = {}


class Choice(NamedTuple):
    """One way to compute a score: its value of a test view, and of a cell from the views' values (N,)."""

    of_view: Callable[[ImagePair], float]
    of_cell: Callable[[np.ndarray], float] = np.mean


def choices(record: Record, weights: Weights) -> dict[str, dict[str, Choice]]:
    """Return the ways to compute each score, by score and name; the record's own comes first."""
    scorer = _scorer(record, weights)
    psnr, ssim, lpips = (_image_metric(name) for name in ("psnr", "ssim", "lpips"))
    border: Border = "valid" if scorer.settings.ssim_border == "zero" else "zero"
    range_: Range = "signed" if scorer.lpips_range == "unit" else "unit"
    nets = [net for net in get_args(Net) if net != scorer.lpips_options.net]
    return {
        "psnr": {
            RECORDED: Choice(psnr),
            "of the mean squared error of all views": Choice(psnr, lambda dB: psnr_of((10 ** (-dB / 10)).mean())),
            "mean over channels": Choice(lambda pair: channel_psnr(*pair.pixels)),
            "after gain and offset": Choice(lambda pair: psnr_affine(*pair.pixels)),
            "of images half as wide": Choice(lambda pair: psnr(halved(pair))),
        },
        "ssim": {
            RECORDED: Choice(ssim),
            f"border {border}": Choice(lambda pair: ssim(replace(pair, convention=Convention(border, scorer.lpips)))),
            "uniform window of 7×7": Choice(_uniform_ssim),
            "of images half as wide": Choice(lambda pair: ssim(halved(pair))),
        },
        "lpips": {
            RECORDED: Choice(lpips),
            f"range {range_}": Choice(_lpips_by(_scorer(record, weights, lpips_range=range_))),
            **{f"network {net}": Choice(_lpips_by(_scorer(record, weights, net=net))) for net in nets},
            "of images half as wide": Choice(lambda pair: lpips(halved(pair))),
        },
    }


def sensitivity(cells: Iterable[Cell], weights: Weights = _NO_WEIGHTS) -> pd.DataFrame:
    """Return COLUMNS: a row per score and convention. Raises ValueError for cells that were scored in several ways.

    weights: files with backbones of LPIPS, for networks that torch's cache lacks.
    mean_change, largest_change: of a cell's score against the record's convention. pairs: of cells that differ in
    method, initial points or variant, on one scene with one seed. reversed: in which the other cell is better now.
    other_best: scenes and seeds in which another cell is the best one. reason: why a convention has no values.
    """
    cells = list(cells)
    if not cells:
        raise ValueError("no finished cell")
    scored = [_scores(cell, weights) for cell in cells]
    if len({tuple(values) for values, _ in scored}) > 1:
        raise ValueError("its cells were scored by several conventions; run them again with one choice of metrics=")
    rows = []
    for score, name in scored[0][0]:
        if name == RECORDED:
            continue
        reasons = [why[score, name] for _, why in scored if (score, name) in why]
        before, after = (np.array([values[score, key] for values, _ in scored]) for key in (RECORDED, name))
        change = after - before
        if reasons:
            rows.append([score, name, 0, np.nan, np.nan, 0, 0, 0, reasons[0]])
        else:
            rows.append([
                score, name, len(cells), change.mean(), change[np.abs(change).argmax()],
                *_order_changes(cells, score, before, after), "",
            ])  # fmt: skip
    return pd.DataFrame(rows, columns=COLUMNS)


def _scores(cell: Cell, weights: Weights) -> tuple[dict[tuple[str, str], float], dict[tuple[str, str], str]]:
    """Return a cell's values by score and convention, NaN where there is none, and the reasons for these."""
    values, reasons = {}, {}
    pairs = list(stored_pairs(cell, _scorer(cell.record, weights).settings))
    for score, by_name in choices(cell.record, weights).items():
        for name, choice in by_name.items():
            values[score, name] = np.nan
            try:
                of_views = np.array([choice.of_view(pair) for pair in pairs])
                values[score, name] = float(choice.of_cell(of_views))
            except NotApplicableError as error:
                reasons[score, name] = str(error)
    return values, reasons


def _order_changes(cells: list[Cell], score: str, before: np.ndarray, after: np.ndarray) -> tuple[int, int, int]:
    """Return pairs of cells that compete, those whose order is reversed, and groups of them with another best."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, cell in enumerate(cells):
        groups.setdefault((*cell.dataset_and_scene, cell.record.seed), []).append(index)
    sign = 1 if MEASURES[score].higher_is_better else -1
    pairs = [pair for group in groups.values() for pair in itertools.combinations(group, 2)]
    swapped = sum((before[i] - before[j]) * (after[i] - after[j]) < 0 for i, j in pairs)
    best = sum(
        group[np.argmax(sign * before[group])] != group[np.argmax(sign * after[group])] for group in groups.values()
    )
    return len(pairs), int(swapped), int(best)


def stored_pairs(cell: CellFolder, convention: Convention) -> Iterator[ImagePair]:
    """Yield the stored thermal render and ground truth of each test view. Raises ValueError for what cannot be read."""
    for view in cell.views_with(TARGETS):
        try:
            target, image, valid = cell.pictures(view)
        except (OSError, ValueError) as error:
            raise ValueError(f"{cell.folder}: {error}") from error
        inside = np.float32(1 if valid is None else valid[..., None])
        image, target = (pixels * inside / np.float32(255) for pixels in (image, target))
        yield ImagePair(image, target, convention, valid)


def halved(pair: ImagePair) -> ImagePair:
    """Return images of half the width and height: means of 2×2 pixels, valid where all four are."""
    height, width = (size // 2 for size in pair.image.shape[:2])

    def blocks(pixels: np.ndarray) -> np.ndarray:
        return pixels[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1)

    image, target = (blocks(pixels).mean(axis=(1, 3)) for pixels in (pair.image, pair.target))
    if pair.valid is None:
        return replace(pair, image=image, target=target)
    valid = blocks(pair.valid[..., None]).min(axis=(1, 3))
    return replace(pair, image=image * valid, target=target * valid, valid=valid[..., 0])


def _image_metric(name: str) -> Callable[[ImagePair], float]:
    metric = METRICS[name]
    assert isinstance(metric, ImageMetric)
    return metric.of_images


def _lpips_by(scorer: Scorer) -> Callable[[ImagePair], float]:
    return lambda pair: scorer.lpips(pair.image, pair.target)


def _scorer(record: Record, weights: Weights, lpips_range: Range | None = None, net: Net | None = None) -> Scorer:
    """Return the record's scorer, or one with another range or network; nothing is downloaded."""
    settings = metric_settings(record.setting("metrics"))
    lpips = settings["lpips"]
    options = LPIPSOptions(net or lpips["net"], weights.get(net or lpips["net"]), download=False)
    convention = settings["convention"], settings["ssim_border"], lpips_range or settings["lpips_range"]
    why_not = "" if net or options.weights else why_no_lpips(lpips, None)
    return _shared(*convention, options, why_not)


@cache
def _shared(convention: ConventionName, border: Border, lpips_range: Range, lpips: LPIPSOptions, why: str) -> Scorer:
    """Return a scorer that loads its network once for all cells. why: it has none."""
    scorer = Scorer(convention, border, lpips_range, lpips)
    scorer.no_lpips = why
    return scorer


def _uniform_ssim(pair: ImagePair) -> float:
    """Return scikit-image's SSIM with its default window, over the valid pixels."""
    images = (pair.image.astype(np.float64), pair.target.astype(np.float64))
    _, values = structural_similarity(*images, data_range=1.0, channel_axis=2, full=True)
    return float(at_valid(pair.valid, values).mean())
