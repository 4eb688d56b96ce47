"""The verdict on a published number: its words, its promise of 5 %, and the seeds that would decide it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tdgbench.tables.measures import digits
from tdgbench.tables.verdicts import (
    BETTER,
    NEVER,
    REPRODUCED,
    UNDECIDED,
    UNKNOWN,
    WORSE,
    judge_published,
    judge_score,
    load_margins,
    seeds_interval,
    seeds_needed,
)

NAN = float("nan")


@pytest.mark.parametrize(
    ("metric", "ours", "published", "std", "seeds", "word"),
    [
        ("psnr", 27.05, 27.0, 0.05, 3, REPRODUCED),
        ("psnr", 27.05, 27.0, 0.15, 3, UNDECIDED),
        ("psnr", 26.0, 27.0, 0.1, 3, WORSE),
        ("psnr", 28.0, 27.0, 0.1, 3, BETTER),
        ("psnr", 28.0, 27.0, 0.3, 2, UNDECIDED),  # two seeds: an interval of ± 1.3 dB
        ("lpips", 0.3, 0.2, 0.001, 3, WORSE),
        ("lpips", 0.1, 0.2, 0.001, 3, BETTER),
        ("ssim", 0.802, 0.8, 0.001, 3, REPRODUCED),
        ("ssim", 0.8047, 0.8, 0.0, 3, UNDECIDED),  # 0.8 may stand for 0.7995
        ("ssim", 0.8044, 0.8, 0.0, 3, REPRODUCED),
        ("ssim", 0.8053, 0.8, 0.0, 3, UNDECIDED),  # 0.8 may stand for 0.8005
        ("ssim", 0.8056, 0.8, 0.0, 3, BETTER),
    ],
)
def test_words(metric, ours, published, std, seeds, word):
    found = judge_published(metric, "Truck", ours, published, std, seeds)
    assert found.verdict == word
    assert bool(found.seeds_needed) == bool(found.undecided_because) == (word == UNDECIDED)


@pytest.mark.parametrize(
    ("metric", "ours", "std", "seeds", "needed", "why"),
    [
        ("psnr", 27.0, NAN, 1, UNKNOWN, "one seed"),
        ("psnr", NAN, 0.1, 3, UNKNOWN, "no number of ours"),
        ("psnr", 27.2, 0.1, 3, NEVER, "at the margin"),
        ("psnr", 27.21, 0.1, 3, "> 100", "crosses the margin"),
        ("train_hours", 27.0, 0.0, 3, NEVER, "machine"),
        ("train_psnr", 27.0, 0.1, 3, NEVER, "no margin"),
    ],
)
def test_undecided_says_why(metric, ours, std, seeds, needed, why):
    found = judge_published(metric, "Truck", ours, 27.0, std, seeds)
    assert found.verdict == UNDECIDED and found.seeds_needed == needed and why in found.undecided_because


def test_the_interval_is_students():
    values = np.array([27.1, 27.4, 27.2])
    low, high = seeds_interval(values.mean(), values.std(ddof=1), 3)
    assert (low, high) == pytest.approx(stats.t.interval(0.9, 2, values.mean(), stats.sem(values)))


@pytest.mark.parametrize("seeds", [2, 3, 5, 10])
@pytest.mark.parametrize("rounding", [-0.5, 0.0, 0.5])
def test_no_word_is_wrong_in_more_than_5_percent(seeds, rounding):
    """At the margin itself, the worst place, and for the worst rounding of the published number."""
    draws, unit, margin = 20_000, 10.0 ** -digits("psnr"), load_margins()["psnr"]
    runs = np.random.default_rng(seeds).normal(margin, 0.15, (draws, seeds))  # around a true value of 0
    low, high = seeds_interval(runs.mean(axis=1), runs.std(axis=1, ddof=1), seeds)
    words = judge_score(low, high, rounding * unit, unit / 2, margin)
    tolerance = 4 * np.sqrt(0.05 * 0.95 / draws)
    for word in (REPRODUCED, BETTER, WORSE):
        assert (words == word).mean() <= 0.05 + tolerance, word
    worst = {-0.5: BETTER, 0.5: REPRODUCED}.get(rounding)  # the word for which this rounding is the worst
    if worst is not None:
        assert (words == worst).mean() >= 0.04  # the promise is used, not undercut


@pytest.mark.parametrize(("distance", "std"), [(0.0, 0.15), (0.1, 0.15), (0.5, 0.15), (1.0, 0.3), (0.05, 0.02)])
def test_that_many_seeds_decide_four_of_five(distance, std):
    needed = int(seeds_needed(distance, std, 0.005, 0.2))
    rates = []
    for seeds in (needed, needed - 1):
        if seeds >= 2:
            runs = np.random.default_rng(needed).normal(distance, std, (20_000, seeds))
            low, high = seeds_interval(runs.mean(axis=1), runs.std(axis=1, ddof=1), seeds)
            rates.append((judge_score(low, high, 0.0, 0.005, 0.2) != UNDECIDED).mean())
    assert rates[0] >= 0.8 - 0.012 and all(rate < 0.8 + 0.012 for rate in rates[1:])


def test_a_margin_needs_its_reason(tmp_path):
    path = tmp_path / "margins.yaml"
    path.write_text("psnr: {margin: 0.2}")
    with pytest.raises(ValueError, match="psnr needs"):
        load_margins(path)
    assert set(load_margins()) == {"psnr", "ssim", "lpips"}
