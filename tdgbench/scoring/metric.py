"""Base classes of metrics: a description, and a function of one rendered test view."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

from tdgbench.scenes.modalities import LABELS, THERMAL
from tdgbench.scoring.measure import Measure
from tdgbench.scoring.scored_view import ImagePair, ScoredView

AFTER_THERMAL = 40  # places in `order` by which metrics of other modalities follow those of thermal images


@dataclass(frozen=True, kw_only=True)
class Metric(Measure, ABC):
    """A score of a rendered view. A module of `metrics/` names its metric `METRIC`."""

    order: int = 1000  # place among the columns of views.csv; equal orders stand by name
    needs: str = ""  # what a scene or method must have to be scored
    fits_to_test_view: str = ""  # what is fitted to a test view before it is scored; empty: nothing
    verified_to: float | None = None  # tolerance when `verify` recomputes it from a cell's files; None: it cannot

    @abstractmethod
    def score(self, shown: ScoredView) -> float:
        """Return the value. Raises NotApplicableError, with the reason, where there is none."""


@dataclass(frozen=True, kw_only=True)
class ImageMetric(Metric):
    """A metric of a render and its ground truth as 8-bit pictures; stored pictures give the same value."""

    of_images: Callable[[ImagePair], float]
    modality: str = THERMAL
    of_every_modality: bool = False  # scores the images of the other modalities, too
    on_training_views: bool = False  # cheap enough to score every training view
    verified_to: float | None = 1e-6

    def score(self, shown: ScoredView) -> float:
        return self.of_images(shown.pair(self.modality))

    def of_modality(self, modality: str) -> ImageMetric:
        """Return the same metric of the method's model of another modality."""
        label = LABELS[modality]
        return replace(
            self, name=metric_name(self.name, modality), images=f"{label} model", modality=modality,
            order=self.order + AFTER_THERMAL, needs=f"{label} model of the method, {label} test images",
            of_every_modality=False, in_main_table=False, on_training_views=False,
        )  # fmt: skip

    def of_training_views(self) -> Measure:
        """Return the description of the mean over the training views."""
        described = {field.name: getattr(self, field.name) for field in fields(Measure)}
        return Measure(**described | {"name": f"train_{self.name}", "images": "training views", "in_main_table": False})


@dataclass(frozen=True, kw_only=True)
class ViewMetric(Metric):
    """A metric that reads more than 8-bit pictures: depth, temperatures, float renders, other views."""

    of_view: Callable[[ScoredView], float]

    def score(self, shown: ScoredView) -> float:
        return self.of_view(shown)


def metric_name(metric: str, modality: str) -> str:
    """Return the name of a metric of a modality's images.

    >>> metric_name("psnr", "thermal"), metric_name("psnr", "rgb")
    ('psnr', 'rgb_psnr')
    """
    return metric if modality == THERMAL else f"{modality}_{metric}"
