"""`tdgbench tables sensitivity DIR`: the stored renders scored by other conventions than the record's.

Papers seldom say how their scores were computed. This shows how far a choice moves the scores, and whether it changes
which method is better. A split cannot be changed without training, and is not among the choices. A range of °C can: of
the stored values, clipped to it and scaled. The models would have been trained on values of that range, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple, get_args

import numpy as np
import pandas as pd
from PIL import Image
from skimage.metrics import structural_similarity

from tdgbench.cells.folder import TARGETS, CellFolder
from tdgbench.cells.metric_settings import metric_settings, why_no_lpips
from tdgbench.cells.record import Record
from tdgbench.scenes.images import resize
from tdgbench.scoring import METRICS, LPIPSOptions, Scorer
from tdgbench.scoring.backbones import Net
from tdgbench.scoring.lpips import Range
from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.metrics.psnr import channel_psnr, psnr_affine, psnr_of
from tdgbench.scoring.scored_view import Border, Convention, ConventionName, ImagePair, NotApplicableError, at_valid
from tdgbench.tables.measures import measure_of
from tdgbench.tables.results import Cell

SENSITIVITY_COLUMNS = [
    "score", "convention", "cells", "mean_change", "largest_change", "pairs", "reversed", "groups",
    "other_best", "ranked", "rank_correlation", "reason",
]  # fmt: skip
RECORDED = "as recorded"  # the first choice of each score
FEWEST_RANKED = 3  # cells that compete, of a rank correlation: that of two is always 1 or -1
NATIVE_SIZES = {"half": 2, "a quarter": 4}  # native sizes: images are so much wider than what their sensor resolves
FILTERS = ("box", "nearest", "bilinear", "lanczos")  # of Pillow
RANGES = {"all of the truth": (0.0, 100.0), "1 % to 99 %": (1.0, 99.0), "5 % to 95 %": (5.0, 95.0)}  # percentiles
MOST_CLIPPED = 0.002  # share of the truth at an end of the stored range; where more is, values beyond are unknown

Weights = Mapping[str, str]  # file by network
_NO_WEIGHTS: Weights = {}


class Choice(NamedTuple):
    """One way to compute a score: its value of a test view, and of a cell from the views' values (N,)."""

    of_view: Callable[[ImagePair], float]
    of_cell: Callable[[np.ndarray], float] = np.mean


def ways_to_score(record: Record, weights: Weights, pairs: Sequence[ImagePair]) -> dict[str, dict[str, Choice]]:
    """Return the ways to compute each score, by score and name; the record's own comes first.

    pairs: of all test views, whose temperatures give the ranges.
    """
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
            **{
                f"°C range: {name}": Choice(partial(_psnr_in_range, record, pairs, ends))
                for name, ends in RANGES.items()
            },
            **_at_native_sizes(psnr),
        },
        "ssim": {
            RECORDED: Choice(ssim),
            f"border {border}": Choice(lambda pair: ssim(replace(pair, convention=Convention(border, scorer.lpips)))),
            "uniform window of 7×7": Choice(_uniform_ssim),
            **_at_native_sizes(ssim),
        },
        "lpips": {
            RECORDED: Choice(lpips),
            f"range {range_}": Choice(_lpips_by(_scorer(record, weights, lpips_range=range_))),
            **{f"network {net}": Choice(_lpips_by(_scorer(record, weights, net=net))) for net in nets},
            "of images half as wide, by box": Choice(lambda pair: lpips(resampled(pair, 2, "box"))),
        },
    }


def sensitivity(cells: Iterable[Cell], weights: Weights = _NO_WEIGHTS) -> pd.DataFrame:
    """Return SENSITIVITY_COLUMNS: a row per score and convention.

    Raises ValueError for cells that were scored in several ways.
    weights: files with backbones of LPIPS, for networks that torch's cache lacks.
    mean_change, largest_change: of a cell's score against the record's convention. pairs: of cells that differ in
    method, initial points or variant, on one scene with one seed. reversed: in which the other cell is better now.
    groups, other_best: scenes and seeds with several cells, and those in which another one is the best. ranked,
    rank_correlation: those with FEWEST_RANKED or more, and the mean of Spearman's correlation there; NaN: none. reason:
    why some cells, `cells` less than all, have no value.
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
        reason = next((why[score, name] for _, why in scored if (score, name) in why), "")
        before, after = (np.array([values[score, key] for values, _ in scored]) for key in (RECORDED, name))
        known = np.flatnonzero(np.isfinite(before) & np.isfinite(after))
        before, after = before[known], after[known]
        changes = (np.nan, np.nan)
        if len(known):
            changes = ((after - before).mean(), (after - before)[np.abs(after - before).argmax()])
        order = _order_changes([cells[i] for i in known], score, before, after)
        rows.append([score, name, len(known), *changes, *order, reason])
    return pd.DataFrame(rows, columns=SENSITIVITY_COLUMNS)


def _scores(cell: Cell, weights: Weights) -> tuple[dict[tuple[str, str], float], dict[tuple[str, str], str]]:
    """Return a cell's values by score and convention, NaN where there is none, and the reasons for these."""
    values, reasons = {}, {}
    pairs = list(stored_pairs(cell, _scorer(cell.record, weights).settings))
    for score, by_name in ways_to_score(cell.record, weights, pairs).items():
        for name, choice in by_name.items():
            values[score, name] = np.nan
            try:
                of_views = np.array([choice.of_view(pair) for pair in pairs])
                values[score, name] = float(choice.of_cell(of_views))
            except NotApplicableError as error:
                reasons[score, name] = str(error)
    return values, reasons


def _order_changes(
    cells: list[Cell], score: str, before: np.ndarray, after: np.ndarray
) -> tuple[int, int, int, int, int, float]:
    """Return the columns from `pairs` to `rank_correlation`."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, cell in enumerate(cells):
        groups.setdefault((*cell.dataset_and_scene, cell.record.seed), []).append(index)
    several = [group for group in groups.values() if len(group) > 1]
    sign = 1 if measure_of(score).higher_is_better else -1
    pairs = [pair for group in groups.values() for pair in itertools.combinations(group, 2)]
    swapped = sum((before[i] - before[j]) * (after[i] - after[j]) < 0 for i, j in pairs)
    best = sum(
        group[np.argmax(sign * before[group])] != group[np.argmax(sign * after[group])] for group in groups.values()
    )
    ranked = pd.Series([rank_correlation(before[group], after[group]) for group in several], dtype=float).dropna()
    return len(pairs), int(swapped), len(several), int(best), len(ranked), float(ranked.mean())


def rank_correlation(before: np.ndarray, after: np.ndarray) -> float:
    """Return Spearman's rank correlation of scores (N,); NaN for fewer than FEWEST_RANKED, or where all are equal.

    >>> rank_correlation(np.array([1.0, 2.0, 3.0]), np.array([1.0, 9.0, 4.0]))
    0.5
    """
    if len(before) < FEWEST_RANKED:
        return float("nan")
    ranks = pd.DataFrame({"before": before, "after": after}).rank()
    return round(float(ranks["before"].corr(ranks["after"])), 12)


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


def _at_native_sizes(score: Callable[[ImagePair], float]) -> dict[str, Choice]:
    """Return the ways to compute a score at sampled native sizes, to which sampled filters bring the images."""

    def of_size(divisor: int, by: str) -> Choice:
        return Choice(lambda pair: score(resampled(pair, divisor, by)))

    sampled = itertools.product(NATIVE_SIZES.items(), FILTERS)
    return {f"of images {name} as wide, by {by}": of_size(divisor, by) for (name, divisor), by in sampled}


def resampled(pair: ImagePair, divisor: int, by: str) -> ImagePair:
    """Return images of 1/divisor of the width and height by a filter, in [0, 1], valid where all that it reads is."""
    height, width = (size // divisor for size in pair.image.shape[:2])
    if not height or not width:
        raise NotApplicableError(f"its images have fewer than {divisor}×{divisor} px")

    def shrunk(pixels: np.ndarray) -> np.ndarray:
        whole = pixels[: divisor * height, : divisor * width].astype(np.float32)
        return resize(whole, width, height, Image.Resampling[by.upper()])

    image, target = (shrunk(pixels).clip(0, 1) for pixels in (pair.image, pair.target))
    if pair.valid is None:
        return replace(pair, image=image, target=target)
    valid = np.isclose(shrunk(pair.valid[..., None]), 1, rtol=0, atol=1e-5)
    if not valid.any():
        raise NotApplicableError("the masks leave no pixel at this size")
    return replace(pair, image=image * valid, target=target * valid, valid=valid[..., 0])


def _psnr_in_range(
    record: Record, pairs: Sequence[ImagePair], percentiles: tuple[float, float], pair: ImagePair
) -> float:
    """Return the PSNR of a pair where percentiles of the true temperatures of all test views are 0 and 1.

    Raises NotApplicableError where the images are no temperatures, or the range is wider than what they hold.
    """
    if record.temperature_range is None:
        raise NotApplicableError("the images are not linear in °C")
    truth = np.concatenate([one.pixels[1].ravel() for one in pairs])
    low, high = np.percentile(truth, percentiles)
    if percentiles == RANGES["all of the truth"] and max((truth <= 0).mean(), (truth >= 1).mean()) > MOST_CLIPPED:
        raise NotApplicableError("the truth is clipped to the recorded range of °C: what lies beyond it is unknown")
    if not low < high:
        raise NotApplicableError("the true temperatures are all equal")
    image, target = (((pixels - low) / (high - low)).clip(0, 1) for pixels in pair.pixels)
    return psnr_of(float(np.mean((image.astype(np.float64) - target) ** 2)))


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
