"""Description of a number that tables print: its name on disk, its label, digits, unit, direction and range."""

from __future__ import annotations

import math
from dataclasses import dataclass


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
    limits: tuple[float, float] = (0.0, math.inf)
    images: str = ""  # the images that the number is of; empty: thermal test views
    latex: str = ""  # label in LaTeX; empty: `label`
    ratio: bool = False  # two values are compared by their ratio, else by their difference
    in_main_table: bool = False  # column of the main table

    @property
    def sign(self) -> int:
        """1 where higher is better, else −1."""
        return 1 if self.higher_is_better else -1

    @property
    def arrow(self) -> str:
        """The better direction."""
        return "↑" if self.higher_is_better else "↓"

    @property
    def suffix(self) -> str:
        """The unit, ready to follow a number."""
        return f" {self.unit}" if self.unit else ""

    @property
    def column(self) -> str:
        """Heading on the terminal."""
        return self.label + self.arrow

    @property
    def title(self) -> str:
        """Heading in the report."""
        name = f"{self.label} of the {self.images}" if self.images else self.label
        return f"{name}{f', {self.unit}' if self.unit else ''} {self.arrow}"

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
