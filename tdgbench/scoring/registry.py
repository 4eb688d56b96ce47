"""The metrics: every `Metric` that a module of `metrics/` defines, for every modality that it scores."""

from __future__ import annotations

import importlib
import pkgutil

from tdgbench.scenes.modalities import OTHERS
from tdgbench.scoring import metrics
from tdgbench.scoring.metric import ImageMetric, Metric


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
    several = [metric for metric in found if isinstance(metric, ImageMetric) and metric.of_every_modality]
    found += [metric.of_modality(modality) for metric in several for modality in OTHERS]
    return {metric.name: metric for metric in sorted(found, key=lambda metric: (metric.order, metric.name))}


METRICS = find_metrics()
TRAIN_METRICS = {
    name: metric for name, metric in METRICS.items() if isinstance(metric, ImageMetric) and metric.on_training_views
}
