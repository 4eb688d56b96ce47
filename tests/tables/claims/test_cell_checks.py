"""Every claim on cells holds, fails and is undecided on cells made for it."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest

from tdgbench.cells.record import Failure
from tdgbench.scenes.registry import ORIGIN
from tdgbench.tables.claims import check_claim, load_claims
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, ClaimEvidence, evidence_of
from tdgbench.tables.published import published_ablation, published_main
from tests.helpers.records import write_record
from tests.tables.claims.small_cells import cell, ours, paper_budget

CLAIMS = {claim.id: claim for claim in load_claims()}
OF_METHODS = [name for name, claim in CLAIMS.items() if claim.check == "better"]
PUBLISHED = ClaimEvidence(published_main(), published_ablation(), printed=True)


def sides(folder, claim, gains, **fields):
    """The claim's cells on one scene for each gain, all of its methods with the gain, all others with none."""
    made, length = [], fields.pop("iterations", 1000)
    for scene, gain in zip("abcd", gains, strict=False):
        for method in (*claim.methods, *claim.against):
            own = {**fields, "iterations": length * claim.stages.get(method, 1)}
            made.append(cell(folder, method, gain * (method in claim.methods), scene=scene, **own))
    return made


@pytest.mark.parametrize(
    ("gains", "verdict"),
    [
        ((1.0, 1.1, 0.9), HOLDS),
        ((-1.0, -1.1, -0.9), FAILS),
        ((0.0, 0.0, 0.0), FAILS),
        ((1.0, -1.0, 0.2), UNDECIDED),
        ((1.0,), UNDECIDED),
    ],
    ids=["better", "worse", "equal", "unclear", "one pair"],
)
@pytest.mark.parametrize("name", OF_METHODS)
def test_claims_that_compare_methods(tmp_path, name, gains, verdict):
    claim = CLAIMS[name]
    found = check_claim(claim, ours(*sides(tmp_path, claim, gains)))
    assert found.verdict == verdict, found.grounds
    expected = "one seed of one scene has no interval" if len(gains) == 1 else "95 % interval over 3 scenes of 3 pairs"
    assert expected in found.grounds and claim.note in found.grounds
    assert check_claim(claim, ours(*sides(tmp_path, replace(claim, against=[]), gains[:1]))).verdict == UNDECIDED


@pytest.mark.parametrize("name", [*OF_METHODS, "random-overfits", "random-fits-training", "random-spoils-rgb"])
def test_the_paper_prints_none_of_it(name):
    found = check_claim(CLAIMS[name], PUBLISHED)
    assert found.verdict == UNDECIDED and found.grounds == f"the paper prints no {CLAIMS[name].unprinted}"


def test_only_cells_of_equal_size_decide_what_depth_saves(tmp_path):
    def sized(gain, number, had):
        place = tmp_path / f"{gain}-{had}"
        for method, scene in product(("tdg", "3dgs_smooth", "msmg"), "abc"):
            record = cell(tmp_path, method, gain * (method == "tdg"), scene=scene).record
            record.config["budget"]["gaussians"], record.parts["thermal"]["gaussians"] = number, had
            write_record(place, record, {})
        return evidence_of([place])

    claim = CLAIMS["depth-saves-gaussians"]
    found = check_claim(claim, sized(1.0, 600, 600))
    assert found.verdict == HOLDS and "over 3 scenes of 3 pairs" in found.grounds
    assert check_claim(claim, sized(-1.0, 600, 600)).verdict == FAILS
    for evidence in (sized(1.0, 600, 599), sized(2.0, None, 600)):
        assert "no cells of ours at equal numbers" in check_claim(claim, evidence).grounds
    assert check_claim(CLAIMS["depth-better"], sized(3.0, 600, 600)).grounds == "no cells of ours"
    assert "score at an equal number" in check_claim(claim, PUBLISHED).grounds


def test_a_claim_holds_as_a_whole(tmp_path):
    """Not by one of its methods, one of its metrics, or half of MFTG's iterations; it may fail by one."""
    claim, gains = CLAIMS["thermalgaussian-thermal"], (1.0, 1.1, 0.9)
    cells = sides(tmp_path, claim, gains)
    part = ours(*(one for one in cells if one.record.method in ("msmg", "3dgs")))
    found = check_claim(claim, part)
    assert found.verdict == UNDECIDED and "not compared: MFTG with 3DGS; OMMG with 3DGS" in found.grounds
    assert (
        check_claim(claim, ours(*sides(tmp_path, replace(claim, methods=["msmg"]), (-1.0, -1.1, -0.9)))).verdict
        == FAILS
    )
    halves = ours(*sides(tmp_path, replace(claim, stages={}), gains))
    assert "not compared: MFTG with 3DGS" in check_claim(claim, halves).grounds
    for one in cells:
        one.record.scores["ssim"] = one.record.scores["ssim"] if one.record.scene == "a" else None
    assert check_claim(claim, ours(*cells)).verdict == UNDECIDED  # 1 − SSIM of one scene has no interval
    depth = CLAIMS["depth-better"]
    without = sides(tmp_path, depth, gains)
    for one in without:
        one.record.scores["lpips"] = None
    found = check_claim(depth, ours(*without))
    assert found.verdict == UNDECIDED and "not compared: LPIPS of TDg with 3DGS, smooth" in found.grounds


def test_seeds_of_one_scene_count_once(tmp_path):
    """Three splits of one seed are one seed."""
    claim, made = CLAIMS["depth-better"], []
    for split, gain in (("folder", 1.0), ("eighty_twenty", 1.1), ("every_8th", 0.9)):
        made += sides(tmp_path, claim, (gain,), split=split)
    found = check_claim(claim, ours(*made))
    assert found.verdict == UNDECIDED and "one seed of one scene has no interval" in found.grounds


def test_trainings_that_fail_are_outcomes(tmp_path):
    claim, _ = CLAIMS["depth-better"], (tmp_path / "cells").mkdir()
    for one in sides(tmp_path / "cells", claim, (1.0, 1.1, 0.9, 1.0)):
        if one.record.method == "tdg" and one.record.scene == "d":
            one.record.status, one.record.failure = "failed", Failure("train", "FloatingPointError: not finite", "")
        write_record(tmp_path / "run", one.record, {})
    found = check_claim(claim, evidence_of([tmp_path / "run"]))
    assert found.verdict == UNDECIDED and "trainings failed, which this leaves out (1 of TDg)" in found.grounds
    write_record(tmp_path / "again", cell(tmp_path / "cells", "tdg", 1.0, scene="d").record, {})
    assert check_claim(claim, evidence_of([tmp_path / "run", tmp_path / "again"])).verdict == HOLDS


def test_the_longest_trainings_decide(tmp_path):
    claim = CLAIMS["depth-better"]
    short = sides(tmp_path, claim, (1.0, 1.1, 0.9))
    assert check_claim(claim, ours(*short)).verdict == HOLDS
    found = check_claim(claim, ours(*short, *sides(tmp_path, claim, (-1.0, -1.1, -0.9), iterations=3000)))
    assert found.verdict == FAILS and found.grounds.endswith("; left out: trainings of 1000 iterations")
    assert "PSNR, TDg − 3DGS, smooth at 3000: -3.00 dB (-3.75 to -2.25), 95 % interval over 3 scenes" in found.grounds
    assert "at 1000" not in found.grounds


def test_gaussians_count_where_density_control_has_begun(tmp_path):
    claim = CLAIMS["msmg-densifies"]
    cells = sides(tmp_path, claim, (1.0, 1.1, 0.9))
    found = {}
    for start in (850, 900):  # the first round is at 900, or left out at 1000: trainings end there
        for one in cells:
            one.record.config["budget"] = paper_budget(iterations=1000)
            one.record.config["budget"]["density"]["start"] = start
        found[start] = check_claim(claim, ours(*cells))
    assert found[850].verdict == HOLDS and found[900].verdict == UNDECIDED
    assert found[900].grounds.endswith("ended before density control began")


@pytest.mark.parametrize("of_built_in", [{"dataset": "synthetic"}, {"dataset": "folder", "assumed": {ORIGIN: "made"}}])
def test_built_in_scenes_decide_no_claim(tmp_path, of_built_in):
    """Nor do their files when they are read as a capture's."""
    claim = CLAIMS["depth-better"]
    made = sides(tmp_path, claim, (1.0, 1.1, 0.9), **of_built_in, prior={"made_from": "truth"})
    found = check_claim(claim, ours(*made))
    assert (
        found.verdict == UNDECIDED and "made from true depth: no evidence on a paper; there it holds" in found.grounds
    )
    found = check_claim(claim, ours(*made, *sides(tmp_path, claim, (-1.0, -1.1, -0.9), dataset="synthetic_hall")))
    assert found.verdict == FAILS and found.grounds.endswith("left out: built-in scenes")


def test_differences_of_what_should_be_low_are_shown_as_they_are(tmp_path):
    claim = CLAIMS["fewer-floaters"]
    grounds = check_claim(claim, ours(*sides(tmp_path, claim, (1.0, 1.1, 0.9)))).grounds
    assert "floaters, TDg − 3DGS, smooth at 1000: -0.1000 (-0.1248 to -0.0752)" in grounds
    grounds = check_claim(CLAIMS["fewer-splits"], ours(*sides(tmp_path, CLAIMS["fewer-splits"], (1.0, 1.0)))).grounds
    assert "prunes, TDg / 3DGS, smooth at 1000: 0.50 (0.50 to 0.50), 95 % interval over 2 scenes of 2 pairs" in grounds
    grounds = check_claim(
        CLAIMS["fewer-splits"], ours(*sides(tmp_path, CLAIMS["fewer-splits"], (0.3, 0.4, 0.5)))
    ).grounds
    assert "3 pairs, one seed each: better, undecided whether by the 25 % that the claim needs (undecided)" in grounds


def test_geometry_of_real_scenes_is_judged_by_consistency(tmp_path):
    cells = sides(tmp_path, CLAIMS["geometry-better"], (1.0, 1.1, 0.9))
    assert "inconsistency" not in check_claim(CLAIMS["geometry-better"], ours(*cells)).grounds
    for one in cells:
        one.record.scores["depth_abs_rel"] = None
    found = check_claim(CLAIMS["geometry-better"], ours(*cells))
    assert found.verdict == HOLDS and "depth inconsistency" in found.grounds and "depth error" not in found.grounds


def test_times_of_other_machines_do_not_compare(tmp_path):
    claim = CLAIMS["single-modality-faster"]
    cells = sides(tmp_path, claim, (1.0, 1.1, 0.9))
    for one in cells:
        one.record.environment = {"cpu": one.record.method}
    found = check_claim(claim, ours(*cells))
    assert found.verdict == UNDECIDED and found.grounds.startswith("no pair of MSMG's thermal model and MSMG")


def test_shares_below_the_margin_fail(tmp_path):
    """A tenth fewer splits is fewer, but not drastically."""
    found = check_claim(CLAIMS["fewer-splits"], ours(*sides(tmp_path, CLAIMS["fewer-splits"], (0.15, 0.15, 0.15))))
    assert found.verdict == FAILS


def by_init(folder, random: dict[str, float], **fields):
    """TDg and MSMG from COLMAP points, and from random ones with that gain, on three scenes."""
    cells = []
    for scene in "abc":
        for method in ("tdg", "msmg"):
            cells.append(cell(folder, method, scene=scene))
            cells += [cell(folder, method, gain, scene=scene, init=init, **fields) for init, gain in random.items()]
    return cells


@pytest.mark.parametrize("name", ["random-fails", "random-overfits", "random-spoils-rgb"])
def test_random_points(tmp_path, name):
    for folder, gains, verdict in (
        ("worse", {"random": -3.0, "random_box": -2.5}, HOLDS),
        ("one is not", {"random": -3.0, "random_box": 0.0}, FAILS),
        ("better", {"random": 1.0}, FAILS),
        ("none", {}, UNDECIDED),
    ):
        (tmp_path / folder).mkdir()
        found = check_claim(CLAIMS[name], ours(*by_init(tmp_path / folder, gains)))
        assert found.verdict == verdict, found.grounds
        assert "random_box" not in gains or "from colmap − MSMG from random_box at 1000" in found.grounds
    assert found.grounds == "no cells from random points"
    unclear = by_init(tmp_path, {"random": -3.0})
    for one in unclear:
        if one.record.init == "random" and one.record.scene == "a":
            one.record.scores |= {"psnr": 40.0, "rgb_psnr": 40.0}
    assert check_claim(CLAIMS[name], ours(*unclear)).verdict == UNDECIDED


@pytest.mark.parametrize(
    ("psnr", "verdict"), [(40.0, HOLDS), (39.5, HOLDS), (36.0, FAILS), (45.0, HOLDS)]
)  # from COLMAP points: 40
def test_random_points_fit_the_training_views(tmp_path, psnr, verdict):
    cells = by_init(tmp_path, {"random": -3.0}, train_scores={"psnr": psnr})
    assert check_claim(CLAIMS["random-fits-training"], ours(*cells)).verdict == verdict
    cells[1].record.train_scores = {"psnr": 20.0}
    assert check_claim(CLAIMS["random-fits-training"], ours(*cells)).verdict in (UNDECIDED, FAILS)


def test_random_fails_as_printed():
    assert check_claim(CLAIMS["random-fails"], PUBLISHED).verdict == HOLDS
    ablation = published_ablation()
    ablation.loc[(ablation["method"] == "tdg") & (ablation["init"] == "random"), "value"] = 25.0
    found = check_claim(CLAIMS["random-fails"], ClaimEvidence(published_main(), ablation, True))
    assert found.verdict == FAILS and "TDg loses 2.42 dB" in found.grounds
    assert check_claim(CLAIMS["random-fails"], ClaimEvidence(published_main(), None, True)).verdict == UNDECIDED


def chain(folder, times: dict[tuple[str, int], float], scenes="abc"):
    cells = []
    for i, scene in enumerate(scenes):
        for (method, iterations), seconds in times.items():
            spread = {"train": seconds * (1 + 0.01 * i)} if method == "tdg" else {"train": seconds}
            cells.append(cell(folder, method, scene=scene, iterations=iterations, seconds=spread))
    return cells


@pytest.mark.parametrize(
    ("smooth", "verdict", "expected"),
    [
        (130, HOLDS, "fewer iterations 50 %, no RGB model -9 %, depth 60 %"),
        (100, UNDECIDED, "fewer iterations 50 %, depth 50 %; depth alone multiplies time by 0.25 (0.24 to 0.25)"),
        (80, FAILS, "no RGB model 8 %, depth 42 %"),
        (25, FAILS, "no RGB model 50 %, depth 0 %"),
        (20, FAILS, "depth -"),
    ],
)
def test_the_speed_up_is_shared_among_its_causes(tmp_path, smooth, verdict, expected):
    times = {("msmg", 3000): 400.0, ("msmg", 1000): 100.0, ("3dgs_smooth", 1000): smooth, ("tdg", 1000): 24.5}
    claim = CLAIMS["speed-from-depth"]
    found = check_claim(claim, ours(*chain(tmp_path, times)))
    assert found.verdict == verdict and expected in found.grounds, found.grounds


def test_attribution_needs_a_sure_speed_up_and_every_link(tmp_path):
    claim = CLAIMS["speed-from-depth"]
    slow = {("msmg", 1000): 100.0, ("3dgs_smooth", 1000): 120.0, ("tdg", 1000): 140.0}
    found = check_claim(claim, ours(*chain(tmp_path, slow)))
    assert found.verdict == UNDECIDED and "no sure speed-up to attribute: time TDg / MSMG at 1000 1.41" in found.grounds
    lacking = {("msmg", 3000): 100.0, ("3dgs_smooth", 1000): 50.0, ("tdg", 1000): 9.0}  # MSMG at 1000
    assert "no cells of tdg, 3dgs_smooth" in check_claim(claim, ours(*chain(tmp_path, lacking))).grounds


def test_better_overall_is_decided_on_pairs(tmp_path):
    claim = CLAIMS["better-overall"]
    for folder, gains, verdict in (
        ("better", (1.0, 1.1, 0.9), HOLDS),
        ("worse", (-1.0, -1.1, -0.9), FAILS),
        ("unclear", (1.0, -1.0, 0.2), UNDECIDED),
    ):
        (tmp_path / folder).mkdir()
        cells = []
        for scene, gain in zip("abc", gains, strict=True):
            cells.append(cell(tmp_path / folder, "tdg", gain, scene=scene))
            cells.append(cell(tmp_path / folder, "msmg", scene=scene, iterations=3000))
        found = check_claim(claim, ours(*cells))
        assert found.verdict == verdict, found.grounds
        assert "PSNR, TDg − MSMG at 1000 and 3000" in found.grounds
    assert check_claim(claim, PUBLISHED).verdict == HOLDS
