"""Methods against one another over seeds: what is decided, what is bold, and the test over scenes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Failure
from tdgbench.tables import methods
from tdgbench.tables.build import build_tables
from tdgbench.tables.comparisons import EQUAL, best_or_tied, change_over_seeds, compare_methods, paired_tests
from tdgbench.tables.findings import findings_of_methods
from tdgbench.tables.long_table import cell_rows
from tdgbench.tables.published import published_main
from tdgbench.tables.results import read_results
from tdgbench.tables.verdicts import BETTER, UNDECIDED, WORSE
from tests.helpers.records import write

NAN = float("nan")


@pytest.mark.parametrize(
    ("metric", "new", "old", "verdict"),
    [
        ("psnr", [21.0, 21.2, 21.1], [20.0, 20.1, 20.2], BETTER),
        ("psnr", [19.0, 19.2, 19.1], [20.0, 20.1, 20.2], WORSE),
        ("psnr", [21.37 - 0.6, 21.37, 21.37 + 0.6], [21.13 + 0.8, 21.13, 21.13 - 0.8], UNDECIDED),
        ("psnr", [40.48, 40.40, 40.50], [40.47] * 3, EQUAL),  # within the margin of 0.2 dB
        ("psnr", [20.2, 20.4, 20.3], [20.0] * 3, BETTER),  # from 0.05, inside the margin, to 0.55 dB
        ("psnr", [41.0], [20.0], UNDECIDED),  # of one seed
        ("psnr", [41.0, NAN], [20.0, 20.1], UNDECIDED),
        ("lpips", [0.1, 0.101], [0.2, 0.201], BETTER),
        ("floaters", [0.2, 0.21, 0.2], [0.1, 0.11, 0.1], WORSE),  # has no margin but print's
        ("train_hours", [0.5, 0.51, 0.5], [1.0, 1.0, 1.01], BETTER),
        ("train_hours", [0.5, 1.5, 1.0], [1.0, 1.0, 1.0], UNDECIDED),
    ],
)
def test_verdicts(metric, new, old, verdict):
    found = change_over_seeds(metric, np.array(new), np.array(old))
    assert found.verdict == verdict
    assert np.isnan(found.ci95_low) == (found.seeds < 2)


def test_the_interval_is_students_of_paired_seeds():
    new, old = np.array([21.0, NAN, 21.5, 21.1]), np.array([20.0, 20.0, 20.1, 20.4])
    found, gains = change_over_seeds("psnr", new, old), np.array([1.0, 1.4, 0.7])
    low, high = stats.t.interval(0.95, 2, gains.mean(), stats.sem(gains))
    assert found[2:6] == pytest.approx((gains.mean(), low, high, 3))
    hours = change_over_seeds("train_hours", np.array([1.0, 2.0]), np.array([2.0, 8.0]))
    assert hours.change == pytest.approx(np.sqrt(0.5 * 0.25)) and hours[:2] == (1.5, 5.0)


@pytest.mark.parametrize(
    ("metric", "by_seed", "bold"),
    [
        ("psnr", [[20.0, 20.1, 20.0], [30.0, 30.1, 30.1]], [False, True]),
        ("lpips", [[0.2, 0.21, 0.2], [0.3, 0.31, 0.3]], [True, False]),
        ("psnr", [[30.0, 30.1, 30.0], [30.0, 30.1, 30.0], [20.0, 20.1, 20.0]], [True, True, False]),  # to the last bit
        ("psnr", [[30.0, 30.9, 30.2], [30.5, 30.1, 30.3], [20.0, 20.1, 20.0]], [True, True, False]),
        ("lpips", [[0.32, 0.322, NAN], [0.305, 0.307, NAN]], [False, False]),  # two seeds
        ("psnr", [[30.0, 30.1, 30.0], [20.0, NAN, 20.0]], [False, False]),  # two in common
        # the second is better in each seed that both have
        ("psnr", [[30.0, 30.1, 30.0, 40.0, 40.1, 40.0], [30.5, 30.6, 30.6, NAN, NAN, NAN]], [False, True]),
        ("barely_seen", [[0.3, 0.31, 0.3], [0.2, 0.21, 0.2]], [False, False]),  # neither side is better
        ("psnr", [[30.0, 30.1, 30.0], [NAN, NAN, NAN]], [False, False]),  # nothing to be better than
    ],
)
def test_bold_is_the_best_and_what_cannot_be_told_from_it(metric, by_seed, bold):
    seeds = np.array(by_seed)
    values = np.array([row[~np.isnan(row)].mean() if not np.isnan(row).all() else NAN for row in seeds])
    assert best_or_tied(metric, values, seeds).tolist() == bold


def changes_of(table: pd.DataFrame) -> pd.DataFrame:
    wide = table.pivot_table(index=["dataset", "scene", "metric"], columns="method", values="value").reset_index()
    rows = [change_over_seeds(r.metric, np.array([r.tdg]), np.array([r.msmg])) for r in wide.itertuples()]
    return pd.concat([wide, pd.DataFrame(rows)], axis=1)


def test_the_test_over_scenes_is_scipys():
    table = published_main().query("not scene.str.contains('Average')")
    found = paired_tests(changes_of(table), table).set_index("metric")
    psnr = table.query("metric == 'psnr'").pivot(index=["dataset", "scene"], columns="method", values="value")
    want = stats.wilcoxon(psnr["tdg"], psnr["msmg"], alternative="greater").pvalue
    assert found.loc["psnr", "p"] == pytest.approx(want)
    assert found.loc["psnr", ["scenes", "better", "worse", "undecided"]].tolist() == [14, 0, 0, 14]  # of one seed
    few = table[table["scene"].isin(["Truck", "Lion"])]
    assert paired_tests(changes_of(few), few)["p"].isna().all()


def test_the_baseline_is_the_one_that_is_there():
    """MSMG needs RGB images: on a capture without any, TDg is compared with 3DGS."""
    columns = ["3dgs", "tdg", "msmg (random)", "tdg (random)", "3dgs (random)", "ommg [budget=lean]"]
    assert methods.baselines(columns) == [
        ("msmg (random)", "3dgs (random)"), ("tdg", "3dgs"), ("tdg (random)", "msmg (random)"),
    ]  # fmt: skip


def test_a_baseline_without_results_is_not_compared_with(tmp_path):
    for method in ("tdg", "3dgs"):
        for seed in (0, 1):
            write(tmp_path, method, "attic", "folder", seed=seed, scores={"psnr": 20.0 + seed + (method == "tdg")})
    Plan(methods=["msmg", "tdg", "3dgs"]).write(tmp_path)
    found = build_tables(tmp_path).findings
    assert found[0].startswith("TDg against 3DGS on attic: PSNR 21.50 against 20.50, +1.00 dB (+1.00 to +1.00): better")


def test_unlike_trainings_and_machines_are_not_compared(tmp_path):
    for method in ("tdg", "msmg"):
        for seed in (0, 1, 2):
            threads = 2 if (method, seed) == ("tdg", 2) else 1
            write(tmp_path, method, "orbit", "synthetic", seed=seed, environment={"threads": threads})
            write(tmp_path, method, "night", "synthetic", seed=seed, environment={"threads": threads})
    results = read_results(tmp_path)
    cells, main = cell_rows(results.records, results.plan), build_tables(tmp_path).main
    kinds = {("tdg", "night"): "iterations: 400"}
    main["training"] = [kinds.get(place, "") for place in zip(main["method"], main["scene"], strict=True)]
    changes = compare_methods(cells, main, results.finished)[0].changes.set_index(["scene", "metric"])
    assert changes.loc[("orbit", "psnr"), "seeds"] == 3 and changes.loc[("orbit", "train_hours"), "seeds"] == 2
    assert changes.loc[("night", "psnr"), "seeds"] == changes.loc[("Average", "psnr"), "seeds"] == 0
    words = {
        place: tuple(changes.loc[place, ["verdict", "reason"]]) for place in (("night", "psnr"), ("orbit", "mae_degC"))
    }
    assert words["night", "psnr"] == ("n/a", "unlike trainings")
    assert words["orbit", "mae_degC"] == ("n/a", "not scored")
    assert changes.loc[("Average", "psnr"), "reason"] == "1 of 2 scenes: unlike trainings"
    assert "Average (Overall)" not in changes.index  # of one data set
    main["training"] = main["method"]
    comparisons = compare_methods(cells, main, results.finished)
    assert findings_of_methods(main, None, comparisons, None, {})[0] == (
        "TDg against MSMG: not compared: trainings differ (msmg / tdg)"
    )


@pytest.mark.parametrize("scenes", [("yard",), ("yard", "hall")])
def test_what_is_na_is_not_compared(tmp_path, scenes):
    """Both methods have the same two budgets, by seed or by scene: means are n/a, and so is what compares them."""
    for method, scene, seed in product(("tdg", "msmg"), scenes, range(4)):
        is_short = scene == "hall" or (len(scenes) == 1 and seed > 1)
        budget = {"name": "short", "iterations": 300} if is_short else {"name": "demo", "iterations": 100}
        psnr = 20.0 + 8 * is_short + (method == "tdg") + seed / 100
        write(tmp_path, method, scene, "folder", seed=seed, scores={"psnr": psnr}, config={"budget": budget})
    tables = build_tables(tmp_path)
    changes = tables.comparisons[0].changes.query("metric == 'psnr'").set_index("scene")
    what = "its scenes or seeds are unlike trainings" if len(scenes) > 1 else "its seeds are unlike trainings"
    place = "Average" if len(scenes) > 1 else "yard"
    assert changes.loc[place, "verdict"] == "n/a" and changes.loc[place, "reason"].startswith(what)
    assert not any("28." in found for found in tables.findings if "on average" in found or len(scenes) == 1)
    if len(scenes) > 1:
        assert changes.loc["yard", "verdict"] == BETTER
    else:
        assert tables.findings[0].startswith(f"TDg against MSMG: not compared: {what} (budget: demo, short")


def test_seeds_that_fail_are_outcomes(tmp_path):
    for method, seed in product(("tdg", "msmg"), range(5)):
        failure = Failure("train", "FloatingPointError: loss is not finite", "")
        more = {"status": "failed", "failure": failure} if method == "tdg" and seed > 2 else {}
        write(tmp_path, method, "yard", "folder", seed=seed, scores={"psnr": 22.0 + seed / 100}, **more)
    assert build_tables(tmp_path).findings[0] == (
        "TDg against MSMG: not compared: TDg: in 2 of 5 seeds failed in train: FloatingPointError: loss is not finite"
    )


def test_times_of_a_busy_machine_are_not_compared(tmp_path):
    """The training waited for other work: its wall time exceeds the processor time of its one thread."""
    for method in ("tdg", "msmg"):
        for seed in (0, 1, 2):
            wait = 4.0 if (method, seed) == ("msmg", 1) else 1.0
            write(tmp_path, method, "attic", "folder", seed=seed, backend="cpu", train_processor_seconds=360.0 / wait)
    tables = build_tables(tmp_path)
    changes = tables.comparisons[0].changes.set_index(["scene", "metric"])
    assert changes.loc[("attic", "train_hours"), "seeds"] == 2 and changes.loc[("attic", "psnr"), "seeds"] == 3
    assert not tables.main.query("metric == 'train_hours'")["bold"].any()
    busy = "times of 1 of 6 cells are of a busy machine (wall time up to 4.0 times the processor time)"
    times = tables.main.query("metric == 'train_hours' and scene == 'attic'").set_index("method")
    assert dict(times["reason"]) == {"msmg": "its mean has times of a busy machine", "tdg": ""}
    assert any(note.startswith(busy) for note in tables.notes)
