"""Every number that tables print: the metrics, the scores of training views, training time, Gaussians.

And the names that all tables share: their key columns, and the rows of averages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isinf, nan
from typing import Any

from tdgbench.cells.plan import MetricEntry, checked
from tdgbench.cells.record import Record
from tdgbench.scenes.inputs import ROWS_OF_AVERAGES
from tdgbench.scenes.modalities import OTHERS
from tdgbench.scoring import METRICS, TRAIN_METRICS
from tdgbench.scoring.metric import Measure, metric_name
from tdgbench.scoring.registry import extra_metrics, on_training_views
from tdgbench.tables.columns import own
from tdgbench.text import duration

KEYS = ["method", "dataset", "group", "scene", "metric"]
AVERAGE, OVERALL = ROWS_OF_AVERAGES
SHORTEST = 59.95  # seconds of a time that is printed as h:mm:ss


@dataclass(frozen=True, kw_only=True)
class RecordMeasure(Measure):
    """A number of a whole cell, read from its record."""

    of_record: Callable[[Record], float]  # NaN: n/a


HOURS = RecordMeasure(
    name="train_hours", label="time", meaning="training time", latex="Time [h]", ratio=True,
    in_main_table=True, of_record=lambda record: record.seconds.get("train", nan) / 3600,
)  # fmt: skip
GAUSSIANS = RecordMeasure(
    name="gaussians", label="Gaussians", meaning="Gaussians at the end, of all models", digits=0, ratio=True,
    of_record=lambda record: float(sum(record.gaussians.values()) or nan),
)  # fmt: skip
PARAMETERS = RecordMeasure(
    name="parameters", label="parameters", meaning="trained numbers of Gaussians and networks", digits=0, ratio=True,
    of_record=lambda record: float(sum(part.get("parameters", 0) for part in record.parts.values()) or nan),
)  # fmt: skip
MEMORY = RecordMeasure(
    name="memory_mb", label="memory of the process", meaning="largest memory of the process that ran the cell",
    unit="MB", digits=0, ratio=True, has_better_side=False,  # the process may have made other cells before
    of_record=lambda record: nan if record.peak_rss_mb is None else record.peak_rss_mb,
)  # fmt: skip
OF_RECORDS = (HOURS, GAUSSIANS, PARAMETERS, MEMORY)  # those that are `in_main_table` are columns of the main table
_TRAIN = [metric.of_training_views() for metric in TRAIN_METRICS.values()]
_BUILT_IN: dict[str, Measure] = {m.name: m for m in (*METRICS.values(), HOURS, *_TRAIN, *OF_RECORDS)}

MAIN_SCORES = tuple(name for name, metric in METRICS.items() if metric.in_main_table)
MAIN_COLUMNS = (*MAIN_SCORES, *(m.name for m in OF_RECORDS if m.in_main_table))  # columns of the main table
_BESIDE = {name: [other for other, metric in METRICS.items() if metric.beside == name] for name in MAIN_COLUMNS}
COLUMNS = tuple(one for name, more in _BESIDE.items() for one in (name, *more))  # where tables are read
ASKED = tuple(measure.name for measure in OF_RECORDS if not measure.in_main_table)  # columns where they are asked for
_EXTRA = [*(name for name in METRICS if name not in COLUMNS), *(measure.name for measure in _TRAIN)]
_OF_MODELS = tuple(tuple(metric_name(name, modality) for name in ("psnr", "ssim")) for modality in OTHERS)
ABLATION_PAIRS = (("psnr", "ssim"), ("train_psnr", "train_ssim"), *_OF_MODELS)  # columns of Table 2
ABLATION = tuple(name for pair in ABLATION_PAIRS for name in pair)


def entries_of(extra: Iterable[str]) -> dict[str, MetricEntry]:
    """Return how tables print the metrics that `metrics.extra` names, those of training views included.

    Raises ValueError for a name that another number of the tables has.
    """
    metrics = {metric.name: metric for metric in extra_metrics(extra)}
    found = [*metrics.values(), *(metric.of_training_views() for metric in on_training_views(metrics).values())]
    taken = [one.name for one in found if one.name in _BUILT_IN]
    if taken:
        raise ValueError(f"metrics.extra: {taken[0]} is another number of the tables; give your metric another name")
    entries = {}
    for one in found:
        stated = {name: getattr(one, name) for name in MetricEntry._fields}
        stated["limits"] = tuple(None if isinf(limit) else limit for limit in one.limits)
        entries[one.name] = checked(MetricEntry, stated, f"metric {one.name}")
    return entries


def own_metrics() -> list[str]:
    """Return the names of the user's metrics (`own_columns`), of which none replaces a number of tdgbench."""
    return [name for name in own().measures if name not in _BUILT_IN]


def known_measures() -> dict[str, Measure]:
    """Return every number that tables print, by name: tdgbench's, then the user's."""
    return _BUILT_IN | {name: own().measures[name] for name in own_metrics()}


def measure_of(name: str) -> Measure:
    """Return the description of a number. Raises KeyError for a metric of the user outside of its `own_columns`."""
    return _BUILT_IN[name] if name in _BUILT_IN else own().measures[name]


def further() -> list[str]:
    """Return the rows of main.csv that are not COLUMNS; the user's metrics come last."""
    return [*_EXTRA, *own_metrics()]


def is_of_training(name: str) -> bool:
    """Return whether a number is a score of training views, where overfitting shows."""
    return name.startswith("train_") and not isinstance(measure_of(name), RecordMeasure)


def digits(name: str, scene: str = "") -> int:
    """Return digits after the decimal point, as the paper prints them: its overall average of SSIM has four.

    >>> digits("ssim"), digits("ssim", OVERALL)
    (3, 4)
    """
    described = measure_of(name)
    if scene == OVERALL and described.overall_digits is not None:
        return described.overall_digits
    return described.digits


def as_text(name: str, value: float, scene: str = "", form: str = "") -> str:
    """Return a number as a reader sees it: with the paper's digits; hours, which files keep as numbers, as h:mm:ss or,
    below a minute, in seconds.

    form: format of numbers that are no time, in the place of the paper's digits; with `+`, times have a sign, too.

    >>> as_text("ssim", 0.88991), as_text("train_hours", 0.5), as_text("train_hours", 0.01, form="+.3f")
    ('0.890', '0:30:00', '+36.0 s')
    """
    if name != HOURS.name:
        return format(value, form or f".{digits(name, scene)}f")
    sign = "-" if value < 0 else "+" if form.startswith("+") else ""
    seconds = abs(value) * 3600
    return sign + (f"{seconds:.1f} s" if seconds < SHORTEST else duration(seconds))


def half_unit(name: str, scene: str = "") -> float:
    """Return half a unit of the last printed digit: how far a printed number may be from the number itself.

    >>> half_unit("psnr")
    0.005
    """
    return 0.5 * 10.0 ** -digits(name, scene)


def gain(name: str, new: Any, old: Any) -> Any:
    """Return by how much the new value is better, in the measure's unit. Arrays broadcast.

    >>> gain("lpips", 0.25, 0.5)
    0.25
    """
    return new - old if measure_of(name).higher_is_better else old - new
