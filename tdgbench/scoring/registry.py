"""The metrics: one per module of `metrics/`, for every modality that it scores."""

from __future__ import annotations

import importlib
import pkgutil

from tdgbench.scenes.modalities import OTHERS
from tdgbench.scoring import metrics
from tdgbench.scoring.metric import ImageMetric, Metric


def find_metrics() -> dict[str, Metric]:
    """Return the `METRIC` of each module of `metrics/` by name, by `order`. Raises TypeError for a module without one.

    One `of_every_modality` is there once more for each modality but thermal.

    >>> [name for name in find_metrics() if name.endswith("psnr")]
    ['psnr', 'channel_psnr', 'rgb_psnr']
    """
    found: list[Metric] = []
    for module in pkgutil.iter_modules(metrics.__path__):
        metric = getattr(importlib.import_module(f"{metrics.__name__}.{module.name}"), "METRIC", None)
        if not isinstance(metric, Metric):
            raise TypeError(f"{metrics.__name__}.{module.name} defines no METRIC")
        found.append(metric)
        if isinstance(metric, ImageMetric) and metric.of_every_modality:
            found += [metric.of_modality(modality) for modality in OTHERS]
    return {metric.name: metric for metric in sorted(found, key=lambda metric: (metric.order, metric.name))}


METRICS = find_metrics()
TRAIN_METRICS = {
    name: metric for name, metric in METRICS.items() if isinstance(metric, ImageMetric) and metric.on_training_views
}
