"""Numbers that tables print, and metrics: a number's description, and a function of one rendered test view."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from numbers import Real

from tdgbench.scenes.modalities import LABELS, THERMAL
from tdgbench.scoring.scored_view import ImagePair, ScoredView

LPIPS_OPTIONS = ("lpips_range", "lpips.net", "lpips.weights_sha256")
FAILED = "failed: "  # begins why a metric of the user is n/a whose code raised an error
SLACK = 1e-6  # of limits, against rounding
AFTER_THERMAL = 40  # places in `order` by which metrics of other modalities follow those of thermal images


class MetricError(Exception):
    """A metric gives a value that it may not have. The message names metric and view, and says what to do."""


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One number of a cell, as tables, LaTeX, terminal, report, statistics, verdicts and claims describe it.

    >>> Measure(name="psnr", label="PSNR", unit="dB", digits=2, higher_is_better=True).title
    'PSNR, dB ↑'
    """

    name: str  # column or key on disk
    label: str  # in print
    meaning: str = ""  # one line for the report
    digits: int = 3  # after the decimal point
    overall_digits: int | None = None  # of the average over all scenes; None: `digits`
    unit: str = ""
    higher_is_better: bool = False
    has_better_side: bool = True  # else no arrow, bold type or verdict
    limits: tuple[float, float] = (0.0, math.inf)
    images: str = ""  # the images that the number is of; empty: thermal test views
    latex: str = ""  # label in LaTeX; empty: `label`
    ratio: bool = False  # two values are compared by their ratio, else by their difference
    in_main_table: bool = False  # column of the main table

    @property
    def arrow(self) -> str:
        """The better direction, if there is one."""
        return "" if not self.has_better_side else "↑" if self.higher_is_better else "↓"

    @property
    def suffix(self) -> str:
        """The unit, ready to follow a number."""
        return f" {self.unit}" if self.unit else ""

    def as_text(self, value: float | None) -> str:
        """Return a value with its digits and unit; n/a for None."""
        return "n/a" if value is None else f"{value:.{self.digits}f}{self.suffix}"

    @property
    def column(self) -> str:
        """Heading on the terminal."""
        return self.label + f", {self.unit}" * (self.unit == "°C") + self.arrow

    @property
    def title(self) -> str:
        """Heading in the report."""
        name = f"{self.label} of the {self.images}" if self.images else self.label
        return f"{name}{f', {self.unit}' if self.unit else ''} {self.arrow}".rstrip()

    @property
    def latex_column(self) -> str:
        """Heading in LaTeX."""
        return rf"{self.latex or self.label} $\{'uparrow' if self.higher_is_better else 'downarrow'}$"

    @property
    def change(self) -> str:
        """Heading of a column of changes."""
        if self.ratio:
            return f"{self.label} ×"
        return f"{self.label}, {self.unit}" if self.unit else self.label


@dataclass(frozen=True, kw_only=True)
class Metric(Measure, ABC):
    """A score of a rendered view. Those that modules of `metrics/` define are scored."""

    order: int = 1000  # place among the columns of views.csv; equal orders stand by name
    needs: str = ""  # what a scene or method must have to be scored
    fits_to_test_view: str = ""  # what is fitted to a test view before it is scored; empty: nothing
    beside: str = ""  # published score that it is a column beside, in tables that are read; empty: no column
    options: tuple[str, ...] = ()  # of `metrics`, that the value depends on
    verified_to: float | None = None  # tolerance when `verify` recomputes it from a cell's files; None: it cannot

    @property
    def of_network(self) -> bool:
        """Whether the value depends on LPIPS's network."""
        return set(LPIPS_OPTIONS) <= set(self.options)

    def score(self, shown: ScoredView) -> float:
        """Return the value. Raises NotApplicableError where there is none, MetricError for none that counts."""
        where, (low, high) = f"metric {self.name} of view {shown.view.name}", self.limits
        try:
            value = self.computed(shown)
        except Exception as error:
            error.add_note(where)
            raise
        if isinstance(value, Real) and math.isfinite(value) and low - SLACK <= value <= high + SLACK:
            return value  # type: ignore[return-value]
        wrong, remedy = f"of type {type(value).__name__}", "return a float"
        if isinstance(value, Real):
            wrong, remedy = f"{value:g}", "cap it" if math.isinf(value) else "return a finite number"
            if math.isfinite(value):
                wrong += f", outside its limits {low:g} to {high:g}"
                remedy = "mend it, declare limits=(LOW, HIGH) that hold it"
        raise MetricError(
            f"{where} is {wrong}: {remedy}, or raise NotApplicableError with the reason where there is no value"
        )

    @abstractmethod
    def computed(self, shown: ScoredView) -> float:
        """Return the value, not checked. Raises NotApplicableError, with the reason, where there is none."""


@dataclass(frozen=True, kw_only=True)
class ImageMetric(Metric):
    """A metric of a render and its ground truth as 8-bit pictures; stored pictures give the same value."""

    of_images: Callable[[ImagePair], float]
    modality: str = THERMAL
    of_every_modality: bool = False  # scores the images of the other modalities, too
    on_training_views: bool = False  # cheap enough to score every training view
    verified_to: float | None = 1e-6

    def computed(self, shown: ScoredView) -> float:
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

    def computed(self, shown: ScoredView) -> float:
        return self.of_view(shown)


def metric_name(metric: str, modality: str) -> str:
    """Return the name of a metric of a modality's images.

    >>> metric_name("psnr", "thermal"), metric_name("psnr", "rgb")
    ('psnr', 'rgb_psnr')
    """
    return metric if modality == THERMAL else f"{modality}_{metric}"
