"""The plot of PSNR against time has few ticks with short texts, whatever numbers records hold."""

from __future__ import annotations

from itertools import pairwise, product
from types import SimpleNamespace

from tdgbench.present.grid import GridCell
from tdgbench.site.psnr_time_plot import BOTTOM, HEIGHT, LEFT, PSNR, RIGHT, TIME, TOP, WIDTH, plot
from tdgbench.tables.measures import COLUMNS

TINY, LARGEST = 5e-324, 1.7976931348623157e308
NUMBERS = [0.0, 40.0, 1e7, 1e17, 1e308, LARGEST]


def plotted(*points: tuple[float, float]) -> dict:
    """The plot of rows with a PSNR (dB) and a time (s)."""
    rows = []
    for psnr, seconds in points:
        scores = [GridCell() for _ in COLUMNS]
        scores[PSNR], scores[TIME] = GridCell(sort=psnr), GridCell(sort=seconds / 3600)
        rows.append(SimpleNamespace(scores=scores, column="tdg", pack=SimpleNamespace(name="a.zip")))
    return plot(rows)


def check(found: dict) -> None:
    """Points and ticks are in the frame, in order, few, with different texts that can be read."""
    for point in found["points"]:
        assert LEFT <= point["x"] <= WIDTH - RIGHT and TOP <= point["y"] <= HEIGHT - BOTTOM
        assert len(point["title"]) < 100
    for ticks, ends in ((found["x_ticks"], (LEFT, WIDTH - RIGHT)), (found["y_ticks"], (HEIGHT - BOTTOM, TOP))):
        assert len(ticks) <= 8 and all(min(ends) <= place <= max(ends) for place, _ in ticks)
        assert len({text for _, text in ticks}) == len(ticks) and all(len(text) <= 13 for _, text in ticks)
    assert len(found["y_ticks"]) >= 2 and all(a[0] > b[0] for a, b in pairwise(found["y_ticks"]))


def test_any_psnr_and_any_time():
    for low, high in product([-number for number in NUMBERS] + NUMBERS, repeat=2):
        check(plotted((low, 10.0), (high, 20.0)))
    for first, last in product([TINY * 3600, 1e-9, 0.5, 59.0, 1e5, 1e30, LARGEST], repeat=2):
        found = plotted((30.0, first), (31.0, last))
        if found is not None:  # hours that round to zero are none
            check(found)


def test_ticks_are_round():
    narrow, wide, impossible = (
        plotted((low, 5.0), (high, 70.0)) for low, high in ((20.1, 21.3), (0.0, 80.0), (0.0, 1e7))
    )
    assert [text for _, text in narrow["y_ticks"]] == ["20.0", "20.5", "21.0", "21.5"]
    assert [text for _, text in wide["y_ticks"]] == ["0", "20", "40", "60", "80"]
    assert [text for _, text in impossible["y_ticks"]] == ["0", "2e+06", "4e+06", "6e+06", "8e+06", "1e+07"]
    assert narrow["x_ticks"][0][1] == "0:00:02"
