import csv
import io

import pandas as pd
import pytest

from tdgbench.text import csv_text, from_csv, one_line
from tests.helpers.names import NAMES


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_names_survive_csv_and_are_no_formula(name):
    stored = io.StringIO(newline="")
    writer = csv.writer(stored)
    writer.writerow(["name"])
    writer.writerow([csv_text(name)])
    text = stored.getvalue()
    for field in (list(csv.reader(io.StringIO(text, newline="")))[1][0], pd.read_csv(io.StringIO(text))["name"][0]):
        assert from_csv(field) == name and not field.startswith(("=", "+", "-", "@"))


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_one_line_is_one_line(name):
    line = one_line(name)
    assert line.isprintable() and len(line.splitlines()) == 1 and (line == name) == name.isprintable()
