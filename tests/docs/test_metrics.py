"""The pages of the metrics: one each, with the facts of its description, and examples whose numbers are right."""

from __future__ import annotations

import doctest
import re

import pytest

from tdgbench.scoring import METRICS, lpips
from tdgbench.tables.measures import COLUMNS
from tests.helpers.paths import ROOT

FOLDER = ROOT / "docs" / "metrics"
THERMAL = {name: metric for name, metric in METRICS.items() if getattr(metric, "modality", "thermal") == "thermal"}


def test_every_metric_has_a_page_and_a_row_of_the_index():
    assert {path.stem for path in FOLDER.glob("*.md")} == {*THERMAL, "README"}
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert all(f"| [`{name}`]({name}.md) |" in index for name in THERMAL)


@pytest.mark.parametrize("name", THERMAL)
def test_facts(name):
    metric, text = THERMAL[name], (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    low, high = (f"{end:g}".replace("inf", "∞") for end in metric.limits)
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", text, re.MULTILINE))
    assert rows["column"] == f"`{name}`" and rows["range"] == f"{low} to {high}{metric.suffix}"
    assert rows["better"] == (metric.arrow or "neither") and rows["fitted to a test view"] == (
        metric.fits_to_test_view or "nothing"
    )
    assert rows["in the main table"].startswith("yes") == (name in COLUMNS)


@pytest.mark.parametrize("name", THERMAL)
def test_examples(name, request, monkeypatch):
    if name == "lpips":
        weights, stored = str(request.getfixturevalue("squeeze_weights")), lpips.trunk_weights
        monkeypatch.setattr(lpips, "trunk_weights", lambda net, *_: stored(net, weights, False))
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    examples = doctest.DocTestParser().get_doctest("".join(text.split("```")[1::2]), {}, name, None, 0)
    assert examples.examples
    results: list[str] = []
    assert doctest.DocTestRunner().run(examples, out=results.append).failed == 0, "".join(results)
