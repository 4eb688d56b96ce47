"""Each check on a main table holds and fails on tables made for it."""

from __future__ import annotations

from itertools import product

import pandas as pd
import pytest

from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.tables.claims import check_claim, load_claims
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, ClaimEvidence, evidence_of
from tdgbench.tables.measures import KEYS
from tdgbench.tables.published import published_ablation, published_main
from tests.helpers.records import write

PUBLISHED = ClaimEvidence(published_main(), published_ablation(), printed=True)
CLAIMS = {claim.id: claim for claim in load_claims()}


def changed(scene, metric, method, value, printed=False):
    """The published table with one value changed."""
    table = published_main()
    at = (table["scene"] == scene) & (table["metric"] == metric) & (table["method"] == method)
    assert at.any()
    table.loc[at, "value"] = value
    return ClaimEvidence(table, published_ablation(), printed)


@pytest.mark.parametrize(
    ("claim", "scene", "metric", "method", "value", "verdict"),
    [
        ("psnr-better", "Average (Overall)", "psnr", "tdg", 27.1827, HOLDS),
        ("ssim-better", "Average (Overall)", "ssim", "tdg", 0.8950, FAILS),
        ("lpips-better", "Average (Overall)", "lpips", "tdg", 0.180, FAILS),
        ("psnr-averages", "Average (Overall)", "psnr", "msmg", 27.30, HOLDS),  # within the verdicts' margin
        ("psnr-averages", "Average (Overall)", "psnr", "msmg", 27.50, FAILS),
        ("time-percent", "Average (Overall)", "train_hours", "tdg", 0.20, FAILS),
        ("faster-everywhere", "Lion", "train_hours", "tdg", 9.0, FAILS),
        ("thermalmix-within", "Lion", "psnr", "tdg", 1.0, FAILS),
        ("averages-follow", "Lion", "psnr", "tdg", 1.0, FAILS),
    ],
)
def test_each_check_can_turn(claim, scene, metric, method, value, verdict):
    assert check_claim(CLAIMS[claim], changed(scene, metric, method, value)).verdict == verdict


def test_checks_that_tell_print_from_ours_can_turn():
    worse = changed("Average (Overall)", "lpips", "tdg", 0.178, printed=True)
    assert check_claim(CLAIMS["better-overall"], worse).verdict == FAILS
    lion = check_claim(CLAIMS["bold-follows"], changed("Lion", "psnr", "tdg", 99.0, printed=True))
    assert lion.grounds == "Ebike LPIPS, RoadBlock SSIM, Lion PSNR"
    slow = check_claim(CLAIMS["time-minutes"], changed("Average (Overall)", "train_hours", "tdg", 0.20, printed=True))
    assert slow.verdict == FAILS
    other = changed("Average (Overall)", "ssim", "msmg", 0.8891, printed=True)
    found = check_claim(CLAIMS["tables-agree"], other)
    assert (found.verdict, found.grounds) == (FAILS, "MSMG SSIM: 0.8896 in the ablation, 0.8891 in the main table")


def with_values(scenes, tdg, msmg, dataset="ThermalMix", printed=True):
    """A main table of some scenes, where a method has one value in every scene and metric."""
    table = published_main().query("scene in @scenes and dataset == @dataset").copy()
    table["value"] = table["method"].map({"tdg": tdg, "msmg": msmg})
    return ClaimEvidence(table, None, printed)


def test_most_cases_are_more_than_half():
    found = check_claim(CLAIMS["most-cases"], PUBLISHED)
    assert found.verdict == HOLDS
    assert found.grounds == "better by any amount in 28 of 42 scenes × metrics, equal in 2 (PSNR 10, SSIM 8, LPIPS 10)"
    two_of_three = with_values(["Lion", "Pan"], 0.9, 0.8)  # better PSNR and SSIM, worse LPIPS
    assert check_claim(CLAIMS["most-cases"], two_of_three).verdict == HOLDS
    assert check_claim(CLAIMS["most-cases"], with_values(["Lion", "Pan"], 0.8, 0.9)).verdict == FAILS
    assert check_claim(CLAIMS["most-cases"], with_values(["Lion", "Pan"], 0.8, 0.8)).verdict == FAILS
    assert check_claim(CLAIMS["most-cases"], with_values([], 0.8, 0.8)).verdict == UNDECIDED


def test_mixed_is_better_here_and_worse_there():
    found = check_claim(CLAIMS["thermalmix-mixed"], PUBLISHED)
    assert found.verdict == HOLDS
    assert found.grounds == "of 15 scenes × metrics TDg is better in 4, worse in 10, equal in 1"
    everywhere = with_values(["Lion", "Pan"], 0.9, 0.8)
    everywhere.main.loc[(everywhere.main["metric"] == "lpips") & (everywhere.main["method"] == "tdg"), "value"] = 0.1
    assert check_claim(CLAIMS["thermalmix-mixed"], everywhere).verdict == FAILS
    other = with_values(["Truck"], 0.9, 0.8, dataset="RGBT-Scenes")
    assert check_claim(CLAIMS["thermalmix-mixed"], other).grounds == "no scene of ThermalMix"


def test_numbers_for_the_papers_scenes_say_nothing_of_others():
    table = published_main()
    table["dataset"] = table["dataset"].replace({"ThermalMix": "synthetic"})
    on_the_papers = {"psnr-averages": HOLDS, "psnr-better": FAILS, "time-percent": HOLDS}
    for claim, verdict in on_the_papers.items():
        found = check_claim(CLAIMS[claim], ClaimEvidence(table, None, printed=False))
        assert (found.verdict, found.grounds) == (UNDECIDED, "a number for the paper's scenes, which these are not")
        assert check_claim(CLAIMS[claim], ClaimEvidence(published_main(), None, printed=False)).verdict == verdict


def test_numbers_for_the_published_setup_say_nothing_of_others(tmp_path):
    for method, scene in product(("tdg", "msmg"), SCENES):
        config = {"budget": {"name": "demo"}}
        write(tmp_path, method, scene.name, DATASETS[scene.dataset], scene.group, config=config)
    found = check_claim(CLAIMS["psnr-averages"], evidence_of([tmp_path]))
    assert found.verdict == UNDECIDED
    assert found.grounds.startswith("a number for the published setup, which this is not: budget demo")
    minutes = check_claim(CLAIMS["time-minutes"], ClaimEvidence(published_main(), None, printed=False))
    assert (minutes.verdict, minutes.grounds) == (UNDECIDED, "minutes depend on the machine")


def test_with_one_data_set_its_average_stands_for_all():
    table = published_main().query("dataset == 'ThermalMix'")
    found = check_claim(CLAIMS["time-percent"], ClaimEvidence(table, None, printed=False, note="5 scenes"))
    assert found.verdict == HOLDS and found.grounds.endswith("is +54.987 %; 5 scenes")


def test_ours_has_no_second_table_that_could_disagree():
    assert check_claim(CLAIMS["tables-agree"], PUBLISHED).verdict == HOLDS
    found = check_claim(CLAIMS["tables-agree"], ClaimEvidence(published_main(), None, printed=False))
    assert found.verdict == UNDECIDED


@pytest.mark.parametrize(
    ("claim", "noise"),
    [("psnr-averages", 0.1), ("time-percent", 0.1), ("faster-everywhere", 0.5),
     ("thermalmix-within", 1.0), ("most-cases", 5.0), ("thermalmix-mixed", 5.0)],
)  # fmt: skip
def test_an_interval_over_seeds_that_reaches_both_sides_decides_nothing(claim, noise):
    table = published_main()
    values, is_tdg = table.set_index(KEYS)["value"], (table["method"] == "tdg").to_numpy()
    for size, verdict in ((0.0, HOLDS), (noise, UNDECIDED)):
        by_seed = pd.DataFrame({seed: values + is_tdg * size * (seed - 1) for seed in range(3)})
        found = check_claim(CLAIMS[claim], ClaimEvidence(table, None, printed=False, by_seed=by_seed))
        assert found.verdict == verdict, found.grounds
    assert "95 % intervals over seeds leave it open" in found.grounds
