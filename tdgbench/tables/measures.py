"""Every number that tables print: the metrics, the scores of training views, training time, Gaussians."""

from __future__ import annotations

from typing import Any

from tdgbench.scoring import METRICS, TRAIN_METRICS
from tdgbench.scoring.measure import Measure
from tdgbench.tables.names import OVERALL

HOURS = Measure(
    name="hours", label="time", meaning="training time", unit="h", latex="Time [h]", ratio=True, published=True
)  # fmt: skip
GAUSSIANS = Measure(name="gaussians", label="Gaussians", meaning="Gaussians at the end", digits=0, ratio=True)
_TRAIN = [metric.of_training_views() for metric in TRAIN_METRICS.values()]
MEASURES: dict[str, Measure] = {m.name: m for m in (*METRICS.values(), HOURS, *_TRAIN, GAUSSIANS)}

PUBLISHED = (*(name for name, metric in METRICS.items() if metric.published), HOURS.name)  # columns of the main table
PUBLISHED_SCORES = PUBLISHED[:-1]
TRAINING = tuple(measure.name for measure in _TRAIN)  # of the training views, where overfitting shows
EXTRA = (*(name for name in METRICS if name not in PUBLISHED), *TRAINING)
ABLATION = tuple(f"{part}{name}" for part in ("", "train_", "rgb_") for name in ("psnr", "ssim"))  # of Table 2


def measure(name: str) -> Measure:
    """The description of a number by its name on disk.

    >>> measure("ssim").title, measure("train_psnr").digits
    ('SSIM ↑', 2)
    """
    return MEASURES[name]


def digits(name: str, scene: str = "") -> int:
    """Digits after the decimal point, as the paper prints them: its overall average of SSIM has four.

    >>> digits("ssim"), digits("ssim", OVERALL)
    (3, 4)
    """
    described = MEASURES[name]
    if scene == OVERALL and described.overall_digits is not None:
        return described.overall_digits
    return described.digits


def half_unit(name: str, scene: str = "") -> float:
    """Half a unit of the last printed digit: how far a printed number may be from the number itself.

    >>> half_unit("psnr")
    0.005
    """
    return 0.5 * 10.0 ** -digits(name, scene)


def gain(name: str, new: Any, old: Any) -> Any:
    """By how much the new value is better, in the measure's unit. Arrays broadcast.

    >>> gain("lpips", 0.25, 0.5)
    0.25
    """
    return MEASURES[name].sign * (new - old)
