from dataclasses import replace

import numpy as np
import pytest

from tdgbench.cells.record import Failure, Record
from tdgbench.tables.measures import AVERAGE, OVERALL
from tdgbench.tables.readings import changes_as_text, effects, reading_cells, readings


def record(method, iterations, psnr, seed=0, scene="orbit", dataset="synthetic", hours=1.0, gaussians=1000):
    return Record(
        method, dataset, scene, "colmap", seed, "readings", f"budget.iterations={iterations}", split="eighty_twenty",
        scores={"psnr": psnr, "ssim": 0.9, "lpips": None}, missing={"lpips": "no backbone"},
        seconds={"train": 3600 * hours}, parts={"thermal": {"gaussians": gaussians}},
        config={"budget": {"iterations": iterations}},
    )  # fmt: skip


CELLS = [
    record("3dgs_smooth", 3000, 30.0, 0), record("3dgs_smooth", 3000, 30.2, 1),
    record("tdg", 3000, 30.5, 0, hours=1.1, gaussians=2000), record("tdg", 3000, 30.9, 1, hours=1.1, gaussians=2000),
    record("tdg", 1000, 29.0, 0, hours=0.25), record("tdg", 1000, 29.1, 1, hours=0.25),
    record("msmg", 3000, 31.0, 0, hours=2.0), record("msmg", 3000, 31.0, 1, hours=2.0),
]  # fmt: skip


def row(table, **wanted):
    for name, value in wanted.items():
        table = table[table[name] == value]
    assert len(table) == 1, table
    return table.iloc[0]


def test_effects_are_paired_by_seed():
    table = effects(reading_cells(CELLS))
    depth = row(table, effect="depth, as written", metric="psnr", scene="orbit")
    assert depth["change"] == pytest.approx(0.6) and depth["seeds"] == 2
    half = 12.7062 * np.std([0.5, 0.7], ddof=1) / np.sqrt(2)
    assert (depth["ci95_low"], depth["ci95_high"]) == (
        pytest.approx(0.6 - half, abs=1e-3),
        pytest.approx(0.6 + half, abs=1e-3),
    )
    assert set(table["metric"]) == {"psnr", "ssim", "train_hours", "gaussians"}  # LPIPS is n/a


def test_unlike_trainings_are_not_paired():
    def metrics_of(**fields):
        pair = record("3dgs_smooth", 3000, 30.0), record("tdg", 3000, 30.5)
        for name, value in fields.items():
            setattr(pair[1], name, value)
        return set(effects(reading_cells(pair))["metric"])

    assert metrics_of() == {"psnr", "ssim", "train_hours", "gaussians"}
    assert metrics_of(environment={"threads": 2}) == {"psnr", "ssim", "gaussians"} and not metrics_of(backend="gsplat")


def test_hours_and_gaussians_are_compared_by_ratio():
    table = effects(reading_cells(CELLS))
    assert row(table, effect="depth, as written", metric="gaussians")["change"] == pytest.approx(2.0)
    whole = row(table, effect="as published: TDg at the fewest for MSMG at the most", metric="train_hours")
    assert whole["change"] == pytest.approx(0.125) and whole["iterations"] == "3000 → 1000"
    fewer = row(table, effect="fewer iterations: tdg", metric="psnr")
    assert fewer["change"] == pytest.approx(-1.65)


def test_averages_are_over_scenes_that_all_have():
    more = [record(m, 3000, p, scene="night") for m, p in (("tdg", 20.5), ("3dgs_smooth", 20.0), ("msmg", 21.0))]
    short = record("tdg", 1000, 19.0, scene="night")
    table = readings(reading_cells([*CELLS[::2], *more, short]))
    assert row(table, method="tdg", iterations=3000, scene=AVERAGE, metric="psnr")["value"] == pytest.approx(25.5)
    assert (table["scene"] != OVERALL).all()
    table = readings(reading_cells([*CELLS[::2], *more]))  # the shorter TDg lacks a scene
    average = row(table, method="tdg", iterations=3000, scene=AVERAGE, metric="psnr")
    assert average["value"] == pytest.approx(30.5)
    found = effects(reading_cells([*CELLS[::2], *more, short]))
    assert row(found, effect="depth, as written", metric="psnr", scene=AVERAGE)["scenes"] == 2


def test_published_numbers_stand_beside_the_published_lengths():
    cells = [
        record(method, iterations, 25.0, scene="Truck", dataset="RGBT-Scenes")
        for method in ("msmg", "tdg") for iterations in (10_000, 30_000)
    ]  # fmt: skip
    table = readings(reading_cells(cells))
    printed = {
        (r.method, r.iterations): r.published
        for r in table[table["metric"] == "psnr"].itertuples()
        if r.scene == "Truck"
    }
    assert printed["msmg", 30_000] == 25.90 and printed["tdg", 10_000] == 26.28
    assert np.isnan(printed["msmg", 10_000]) and np.isnan(printed["tdg", 30_000])
    assert table.loc[table["scene"] != "Truck", "published"].isna().all()  # averages over one scene of nine
    random = readings(reading_cells([replace(cell, init="random") for cell in cells]))
    assert random["published"].isna().all()  # from COLMAP's points


def test_no_mean_is_over_priors_or_unlike_trainings():
    near, far, other = (record("tdg", 3000, psnr, seed) for psnr, seed in ((20.0, 0), (24.0, 0), (22.0, 1)))
    without = record("3dgs_smooth", 3000, 19.0)
    for one in (near, without):
        one.variant += ",prior=marigold"
    table = readings(reading_cells([near, far, other, without])).query("metric == 'psnr'").set_index("method")
    assert table["value"].to_dict() == {"tdg [prior=marigold]": 20, "tdg": 23, "3dgs_smooth [prior=marigold]": 19}
    assert table["seeds"].to_dict() == {"tdg [prior=marigold]": 1, "tdg": 2, "3dgs_smooth [prior=marigold]": 1}
    found = effects(reading_cells([near, far, other, without])).query("metric == 'psnr'")
    assert found[["effect", "change"]].to_numpy().tolist() == [["depth, as written [prior=marigold]", 1.0]]
    other.backend = "gsplat"
    table = readings(reading_cells([far, other])).query("metric == 'psnr'")
    assert table["value"].isna().all() and (table["seeds"] == 2).all()
    pairs = [far, other, *(record("3dgs_smooth", 3000, 19.0, seed) for seed in (0, 1))]
    pairs[-1].backend = "gsplat"
    assert effects(reading_cells(pairs)).empty and not effects(reading_cells(pairs[::2])).empty


def test_failed_cells_say_nothing():
    failed = record("tdg", 3000, 30.0)
    failed.failure = Failure("train", "NonFiniteError: no", "")
    assert reading_cells([failed]).empty and effects(reading_cells([failed])).empty
    assert readings(reading_cells([failed])).empty


def test_changes_in_words_name_the_split_where_there_are_several():
    heads, rows = changes_as_text(effects(reading_cells(CELLS)))
    assert heads[:3] == ["change", "iterations", "scene"]
    found = {(name, lengths): numbers for name, lengths, _, *numbers in rows}
    assert found["depth, as written", "3000"][0] == "+0.60 (-0.67 to +1.87)"
    assert found["fewer iterations: tdg", "3000 → 1000"][0].startswith("-1.65") and "n/a" in rows[0]
    other = [record("tdg", 3000, 27.0), record("3dgs_smooth", 3000, 26.0)]
    for one in other:
        one.split = "folder"
    _, rows = changes_as_text(effects(reading_cells([*CELLS, *other])))
    assert ("depth, as written (folder)", "3000", "+1.00") in {(row[0], row[1], row[3]) for row in rows}
