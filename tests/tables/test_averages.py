"""Which printed averages follow from their rows, within what print hides."""

from __future__ import annotations

import pandas as pd
import pytest

from tdgbench.tables.averages import FOLLOWS, OFF, UNKNOWN, check_averages


def table(rows, average, half_unit=0.005, metric="psnr"):
    values = {"a": rows[0], "b": rows[1], "Average": average} if rows else {"Average": average}
    return pd.DataFrame(
        [("m", "D", "", scene, metric, value, half_unit) for scene, value in values.items()],
        columns=["method", "dataset", "group", "scene", "metric", "value", "half_unit"],
    )


@pytest.mark.parametrize(
    ("rows", "average", "verdict"),
    [
        ((20.0, 21.0), 20.5, FOLLOWS),
        ((20.0, 21.01), 20.51, FOLLOWS),
        ((20.0, 21.0), 20.51, FOLLOWS),  # both rows may have been rounded down
        ((20.0, 21.0), 20.52, OFF),
        ((20.0, 21.0), 20.48, OFF),
        ((), 20.5, UNKNOWN),
        ((20.0, float("nan")), 20.5, UNKNOWN),
    ],
)
def test_verdicts(rows, average, verdict):
    found = check_averages(table(rows, average))
    assert found["verdict"].tolist() == [verdict]


def test_a_coarser_row_widens_the_tolerance():
    rows = table((0.17, 0.124), 0.145, 0.0005, "lpips")
    assert check_averages(rows)["tolerance"].item() == pytest.approx(0.001)
    rows.loc[0, "half_unit"] = 0.005
    assert check_averages(rows)["tolerance"].item() == pytest.approx(0.0005 + 0.00275)
