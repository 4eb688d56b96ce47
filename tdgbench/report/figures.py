"""Figures on disk: written whole or not at all, all at one resolution."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from tdgbench.files import whole_file

DPI = 110


def save_figure(figure: Figure, target: Path) -> None:
    """Write a figure as PNG."""
    with whole_file(target) as part:
        figure.savefig(part, dpi=DPI)
