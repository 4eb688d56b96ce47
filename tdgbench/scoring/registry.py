"""The metrics: every `Metric` that a module of `metrics/` defines, and those of the user that `metrics.extra` names."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from pathlib import Path

from tdgbench.scenes.modalities import OTHERS
from tdgbench.scoring import metrics
from tdgbench.scoring.metric import ImageMetric, Metric
from tdgbench.text import first_few, meant


def find_metrics() -> dict[str, Metric]:
    """Return the metrics of all modules of `metrics/` by name, by `order`. Raises TypeError for a module without one.

    One `of_every_modality` is there once more for each modality but thermal.

    >>> [name for name in find_metrics() if name.endswith("psnr")]
    ['psnr', 'channel_psnr', 'rgb_psnr']
    """
    found: list[Metric] = []
    for module in pkgutil.iter_modules(metrics.__path__):
        content = vars(importlib.import_module(f"{metrics.__name__}.{module.name}")).values()
        defined = [metric for metric in content if isinstance(metric, Metric)]
        if not defined:
            raise TypeError(f"{metrics.__name__}.{module.name} defines no metric")
        found += defined
    return _by_name(_of_all_modalities(found))


def extra_metrics(names: Iterable[str]) -> list[Metric]:
    """Import the metrics of the user by their names, MODULE.NAME; those `of_every_modality` for each of them.

    Raises ValueError, with the reason, for a name that cannot be imported or is no metric, and for metrics that have
    the name of another one or ask to be a column of the main table.
    """
    found = _of_all_modalities([_imported(name) for name in names])
    for i, metric in enumerate(found):
        if metric.name in {*METRICS, *(other.name for other in found[:i])}:
            raise ValueError(f"there is another metric {metric.name}; give yours another name")
        if not metric.name.isidentifier() or not metric.limits[0] < metric.limits[1]:
            raise ValueError(
                f"metric {metric.name!r}: a name has letters, digits and underscores, limits are (LOW, HIGH)"
            )
        if metric.in_main_table or metric.beside:
            raise ValueError(
                f"{metric.name} may not be a column of the main table (in_main_table, beside), which is that of the "
                "published scores; tdgbench tables DIR --columns shows it"
            )
    return found


def with_extra(names: Iterable[str]) -> dict[str, Metric]:
    """Return METRICS and those of `extra_metrics` by name, by `order`."""
    return _by_name([*METRICS.values(), *extra_metrics(names)])


def on_training_views(among: Mapping[str, Metric]) -> dict[str, ImageMetric]:
    """Return the metrics that score training views, too."""
    return {n: metric for n, metric in among.items() if isinstance(metric, ImageMetric) and metric.on_training_views}


def _imported(name: str) -> Metric:
    module, _, variable = name.rpartition(".")
    here = [path.stem for path in sorted(Path.cwd().glob("*.py"))]
    if not module:
        of_here = f"{name}.NAME" if name in here else first_few(f"{one}.{name}" for one in here)
        raise ValueError(f"{name} is no MODULE.NAME; of the modules here it may be {of_here or 'none'}")
    try:
        content = vars(importlib.import_module(module))
    except Exception as error:  # a module of the user may raise anything
        near = ""
        if isinstance(error, ModuleNotFoundError) and error.name == module:
            near = meant(module, here) or "; run this in its folder, or install it"
        raise ValueError(f"{name} cannot be imported ({type(error).__name__}: {error}){near}") from error
    found = content.get(variable)
    if not isinstance(found, Metric):
        there = [one for one, value in content.items() if isinstance(value, Metric)]
        near = meant(variable, there) or f"; the metrics of {module}: {first_few(there) or 'none'}"
        raise ValueError(f"{name} is no ImageMetric and no ViewMetric of tdgbench.scoring.metric{near}")
    return found


def _of_all_modalities(found: list[Metric]) -> list[Metric]:
    several = [metric for metric in found if isinstance(metric, ImageMetric) and metric.of_every_modality]
    return found + [metric.of_modality(modality) for metric in several for modality in OTHERS]


def _by_name(found: list[Metric]) -> dict[str, Metric]:
    return {metric.name: metric for metric in sorted(found, key=lambda metric: (metric.order, metric.name))}


METRICS = find_metrics()
TRAIN_METRICS = on_training_views(METRICS)
