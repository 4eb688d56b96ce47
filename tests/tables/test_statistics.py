from __future__ import annotations

import numpy as np
import pytest

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import read_all
from tdgbench.tables.build import build_tables
from tdgbench.tables.long_table import cell_rows, scene_rows, with_averages
from tdgbench.tables.published import published_main
from tdgbench.tables.results import read_results
from tdgbench.tables.statistics import UNEQUAL_SEEDS, intervals, with_seeds
from tdgbench.tables.verdicts import REPRODUCED, UNDECIDED
from tests.helpers.records import published_as_records, write


def with_views(folder, psnr):
    heads = "view,psnr,ssim,lpips,mae_degC,depth_abs_rel"
    lines = [heads, *(f"v{i},{v},0.8,n/a,n/a,n/a" for i, v in enumerate(psnr))]
    (folder / "views.csv").write_text("\n".join(lines) + "\n")


def test_spread_over_seeds(tmp_path):
    for seed, (a, b) in enumerate([(20.0, 30.0), (22.0, 30.0), (21.0, 33.0)]):
        for scene, value in (("Truck", a), ("Dimsum", b)):
            write(tmp_path, scene=scene, seed=seed, scores={"psnr": value})
    cells = cell_rows(read_all(tmp_path), Plan())
    found, by_seed = with_seeds(with_averages(scene_rows(cells)), cells)
    psnr = found.query("metric == 'psnr' and method == 'tdg'").set_index("scene")
    assert by_seed[found["scene"] == "Truck"].dropna().to_numpy().tolist()[0] == [20.0, 22.0, 21.0]
    assert psnr.loc["Truck", "std"] == pytest.approx(1.0) and psnr.loc["Truck", "seeds"] == 3
    assert np.isnan(psnr.loc["Average", "std"]).all()  # other scenes of the data set are missing
    assert psnr.loc["Lion", "seeds"] == 0


def test_an_average_over_unequal_seeds_has_no_spread(tmp_path):
    """Two seeds of all scenes are the published table; one scene has three more, 9 dB above."""
    for seed in (0, 1):
        published_as_records(tmp_path, seed=seed)
    for seed in (2, 3, 4):
        write(tmp_path, "tdg", "Truck", seed=seed, scores={"psnr": 36.0, "ssim": 0.878, "lpips": 0.133})
    tables = build_tables(tmp_path)
    found = tables.difference.query("metric == 'psnr' and method == 'tdg'").set_index("scene")
    for place in ("Average (Overall)", "Average"):
        row = found[(found.index == place) & (found["dataset"] != "ThermalMix")].iloc[0]
        assert row["verdict"] == UNDECIDED and row["undecided_because"] == UNEQUAL_SEEDS and np.isnan(row["std"])
    row = found[(found.index == "Average") & (found["dataset"] == "ThermalMix")].iloc[0]
    assert row["verdict"] == REPRODUCED and row["seeds"] == 2
    reasons = tables.main.query("scene == 'Average (Overall)' and metric == 'psnr'").set_index("method")["reason"]
    assert reasons.to_dict() == {"msmg": "", "tdg": UNEQUAL_SEEDS}


def test_intervals_hold_what_the_samples_hold(tmp_path):
    rng = np.random.default_rng(1)
    for seed in range(3):
        with_views(write(tmp_path, scene="Truck", seed=seed), 20 + rng.normal(size=12))
    cells = read_results(tmp_path).finished
    found = intervals(cells).set_index("metric")
    row = found[found["scene"] == "Truck"].loc["psnr"]
    assert 19 < row["ci95_low"] < 20 < row["ci95_high"] < 21.2 and row["ci95_high"] - row["ci95_low"] > 0.2
    assert "lpips" not in found.index  # n/a in every view
    main = build_tables(tmp_path).main
    assert main.loc[main["value"].isna(), "ci95_low"].isna().all()
    assert intervals(cells).equals(intervals(read_results(tmp_path).finished))


def test_more_seeds_of_the_same_views_do_not_narrow_an_interval(tmp_path):
    """Views are the same in all seeds: three equal trainings tell what one does."""
    psnr, widths = 20 + np.random.default_rng(1).normal(size=12), []
    for experiment, seeds in (("one", 1), ("three", 3)):
        for seed in range(seeds):
            with_views(write(tmp_path / experiment, seed=seed), psnr)
        row = intervals(read_results(tmp_path / experiment).finished).set_index("metric").loc["psnr"]
        widths.append((row["ci95_high"] - row["ci95_low"]).max())
    assert widths[1] == pytest.approx(widths[0], rel=1e-9)


def test_an_average_has_an_interval_only_if_all_of_its_scenes_have(tmp_path):
    for scene in ("Truck", "Dimsum"):
        folder = write(tmp_path, scene=scene)
        if scene == "Truck":
            with_views(folder, [20.0, 21.0, 22.0])
    found = intervals(read_results(tmp_path).finished).query("metric == 'psnr'").set_index("scene")
    assert found.loc["Truck", "ci95_low"] < 21 and np.isnan(found.loc["Average", "ci95_low"])


def test_the_published_numbers_are_reproduced_by_themselves(tmp_path, published_tables):
    assert set(published_tables.difference["verdict"]) == {UNDECIDED}  # one seed
    for seed in (0, 1):
        published_as_records(tmp_path, seed)
    tables = build_tables(tmp_path)
    of_scores = tables.difference[tables.difference["metric"] != "train_hours"]
    assert set(of_scores["verdict"]) == {REPRODUCED} and (of_scores["seeds"] == 2).all()
    assert set(tables.difference.query("metric == 'train_hours'")["verdict"]) == {UNDECIDED}
    changes = tables.comparisons[0].changes
    hours = published_main().query("metric == 'train_hours' and not scene.str.contains('Average')")
    hours = hours.pivot(index="scene", columns="method", values="value")
    times = changes[changes["metric"] == "train_hours"].set_index("scene")["change"]
    assert times[hours.index].to_dict() == pytest.approx((hours["tdg"] / hours["msmg"]).to_dict())
