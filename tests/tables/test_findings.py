"""Findings in sentences: the numbers of the tables, and no others."""

from __future__ import annotations

import pandas as pd
import pytest

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Failure, read_all
from tdgbench.scenes import Description
from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.tables.build import build_tables
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, JudgedClaim
from tdgbench.tables.findings import claims_in_words, published
from tdgbench.tables.grids import SPREAD, TIMES
from tdgbench.tables.show import show_tables
from tests.helpers.records import write, write_ablation, write_record

PAPER = [Description(s.name, DATASETS[s.dataset], s.group) for s in SCENES]


def test_one_seed_concludes_nothing(published_tables):
    found = published_tables.findings
    assert found[0].startswith(
        "TDg against MSMG on average over 14 scenes: PSNR 27.42 against 27.18, +0.24 dB; SSIM 0.8899 against 0.8896, "
        "+0.0004; LPIPS 0.175 against 0.177, -0.002; time 0:10:34 against 0:23:21, × 0.45; "
        "PSNR of single scenes -0.78 to +1.79 dB; one seed decides "
        "nothing: the largest standard deviation over seeds that was measured on these or other scenes from "
        "sparse points, of some method and budget (TDg, budget paper, two seeds), is 6.1 dB PSNR "
        "(docs/findings/verdicts.md); "
        "by the published table time × 0.45"
    )
    assert found[1:] == ["0 of 102 published scores reproduced, 102 undecided: run `seed=0,1,2`"]
    assert (published_tables.folder / "findings.txt").read_text(encoding="utf-8").splitlines() == found


def test_they_say_what_the_seeds_tell(tmp_path):
    """40.48 dB against 40.47, whose seeds differ by more: undecided, and in bold together."""
    psnr = {"msmg": (39.9, 40.6, 40.91), "tdg": (40.1, 40.3, 41.04), "3dgs": (35.0, 35.1, 35.3)}
    for method, values in psnr.items():
        for seed, value in enumerate(values):
            prior = {"made_from": "truth"} if method == "tdg" else None
            write(tmp_path, method, "orbit", "synthetic", seed=seed, scores={"psnr": value, "lpips": None}, prior=prior,
                  environment={"cells_at_once": 2})  # fmt: skip
    tables = build_tables(tmp_path)
    assert "no bold type: it needs 3 seeds of each method" not in tables.grid.notes
    notes = {"times are of 2 cells at once, which may slow each other down", SPREAD, TIMES}
    assert notes <= set(tables.grid.notes)
    assert "Built-in scenes (synthetic)" in tables.latex and "Day light" not in tables.latex
    assert "of TDg is made from true depth" in tables.latex and "number of seeds: 3" in tables.latex
    assert tables.findings[0] == (
        "MSMG against 3DGS on orbit: PSNR 40.47 against 35.13, +5.34 dB (+4.39 to +6.29): better; SSIM 0.800 against "
        "0.800, +0.000 (+0.000 to +0.000): equal within 0.005; time 0:06:00 against 0:06:00, × 1.00 (1.00 to 1.00): "
        "equal; in brackets: 95 % intervals over 3 seeds; those of times leave out what a "
        "repeated run changes; times are of 2 cells at once, which may slow each other down"
    )
    assert tables.findings[1].startswith(
        "TDg with a depth prior made from true depth against MSMG on orbit: PSNR 40.48 against 40.47, +0.01 dB "
        "(-0.66 to +0.68): undecided;"
    )
    assert tables.main.query("metric == 'psnr' and bold and scene == 'orbit'")["method"].tolist() == ["msmg", "tdg"]


@pytest.mark.parametrize(
    ("psnr", "said"),
    [
        ([19.83, 19.86, 19.89], "-0.14 dB (-0.21 to -0.07): lower, whether by more than 0.2 dB is undecided;"),
        ([19.93, 19.95, 19.97], "-0.05 dB (-0.10 to -0.00): equal within 0.2 dB;"),
        ([18.5, 19.1], "-1.20 dB: undecided (two seeds);"),
    ],
)
def test_they_say_no_more_than_the_interval(tmp_path, psnr, said):
    for seed, value in enumerate(psnr):
        skips = [
            {"name": "plateau", "allowed": True, "taken": False, "reason": "the loss went on falling", "saved": ""}
        ]
        write(tmp_path, "tdg", "attic", "folder", seed=seed, scores={"psnr": value}, prior={"made_from": "files"},
              skips=skips)  # fmt: skip
        write(tmp_path, "msmg", "attic", "folder", seed=seed, skips=skips)
    found = build_tables(tmp_path).findings
    prior = "a depth prior made from files of unknown origin"
    assert found[0].startswith(f"TDg with {prior} against MSMG on attic: PSNR ") and said in found[0]
    assert (
        found[1].startswith("All trainings ended by their number of iterations, not at a plateau") and len(found) == 3
    )


def test_scores_that_test_views_chose_are_told_wherever_they_stand(tmp_path, capsys):
    made = {"files": "0", "summary": "made elsewhere", "checkpoint_rule": "best_test_view"}
    write(tmp_path, "tdg", "attic", "folder", made_elsewhere=made)
    write(tmp_path, "msmg", "attic", "folder")
    tables = build_tables(tmp_path)
    note = "selected: TDg: its checkpoint was chosen by test views, so its scores are too high beside the others"
    show_tables(tables)
    assert note in capsys.readouterr().out.splitlines() and note in tables.latex
    told = pd.read_csv(tmp_path / "tables" / "main.csv").groupby("method")["training"].unique()
    assert told["tdg"].tolist() == ["checkpoint: chosen by test views"] and told["msmg"].isna().all()
    assert tables.findings[0].startswith(
        "TDg (checkpoint chosen by test views: its scores are too high) against MSMG on attic: PSNR "
    )


def test_they_count_what_the_tables_say(tmp_path):
    for seed in range(3):
        for method, psnr in (("tdg", 26.28), ("msmg", 20.0)):
            noise = 0.01 * seed if method == "tdg" else 1.0 * seed
            write(tmp_path, method, "Truck", seed=seed, scores={"psnr": psnr + noise, "lpips": None})
    write(tmp_path, "tdg", "Lion", "ThermalMix", seed=0, scores={"psnr": 5.0, "ssim": 0.991, "lpips": None})
    tables = build_tables(tmp_path)
    known = tables.difference.query("metric in ('psnr', 'ssim') and difference.notna()")
    verdicts = known["verdict"].value_counts()
    assert tables.findings[0].startswith(
        "TDg against MSMG on Truck: PSNR 26.29 against 21.00, +5.29 dB (+2.83 to +7.75): "
    )
    assert tables.findings[0].endswith(
        "; in brackets: 95 % intervals over 3 seeds; those of times leave out what a repeated run changes; "
        "by the published table time × 0.59; n/a on 13 more"
    )
    assert known.set_index(["scene", "metric"])["verdict"]["Lion"].to_dict() == {
        "psnr": "not reproduced",
        "ssim": "undecided",
    }
    last = tables.findings[-1]
    assert last.startswith(f"{verdicts['reproduced']} of 6 published scores reproduced, ")
    assert all(f"{count} {word}" in last for word, count in verdicts.items() if word != "reproduced")
    assert last.endswith(
        "run `seed=0,1,2` (96 more have none of ours beside them; not reproduced: off by more than 3 times the largest "
        "spread over seeds, 6.1 dB PSNR)"
    )


def test_equal_data_count_once(tmp_path):
    """Six scenes, five of one capture under other names: no test over six scenes."""
    for i, scene in enumerate("abcdef"):
        for method, psnr in (("tdg", 21.0), ("msmg", 20.0)):
            for seed in (0, 1):
                truth = {f"{scene}.png": f"{max(i, 4):064x}"}
                write(tmp_path, method, scene, "folder", seed=seed, scores={"psnr": psnr + seed}, truth=truth)
    found = build_tables(tmp_path).findings
    assert found[0].startswith("TDg against MSMG on 2 scenes: PSNR better on 2; SSIM equal on 2; ")
    assert found[0].endswith("n/a on 4 more") and found[1].startswith("TDg against MSMG on average over 2 scenes: ")
    assert found[-1] == (
        "folder/b, folder/c, folder/d, folder/e have the test images of folder/a, byte by byte: counts, p and "
        "differences have them once; the table's averages have each"
    )


@pytest.mark.parametrize(
    ("verdicts", "sentence"),
    [
        ([("reproduced", "", "")] * 2, "2 of 2 published scores reproduced"),
        ([("better", "", ""), ("worse", "", "")], "0 of 2 published scores reproduced, 1 better, 1 worse"),
        (
            [("reproduced", "", ""), ("undecided", "unknown", "one seed has no spread")],
            "1 of 2 published scores reproduced, 1 undecided: run `seed=0,1,2`",
        ),
        (
            [("undecided", "5", "crosses"), ("undecided", "n/a", "at the margin")],
            "0 of 2 published scores reproduced, 2 undecided: 5 seeds would decide 1; no number of seeds for 1",
        ),
        (
            [("undecided", "5", "crosses"), ("undecided", "unknown", "one seed has no spread")],
            "0 of 2 published scores reproduced, 2 undecided: 5 seeds would decide 1; run `seed=0,1,2`",
        ),
    ],
)
def test_published_scores(verdicts, sentence):
    rows = pd.DataFrame(verdicts, columns=["verdict", "seeds_needed", "undecided_because"]).assign(
        metric="psnr", difference=0.1
    )
    hours = rows.iloc[:1].assign(metric="train_hours")  # they depend on the machine
    assert published(pd.concat([rows, hours])) == sentence


def test_na_says_why(tmp_path):
    Plan("main", PAPER, ["msmg", "tdg"]).write(tmp_path)
    assert build_tables(tmp_path).findings == [
        "TDg against MSMG: not compared: no scene is on disk, or none was run",
        "None of the 102 published scores is compared: there are no results of their scenes",
    ]
    write(tmp_path, "tdg", status="failed", failure=Failure("prior", "PriorError: no weights", ""))
    write(tmp_path, "msmg", "Lion", "ThermalMix", "360")
    assert build_tables(tmp_path).findings[0] == "TDg against MSMG: not compared: no scene has results of both"


CAPTURE = "tdgbench has no published scores of these scenes"


def test_a_capture_alone(tmp_path):
    for seed in (0, 1):
        write(tmp_path, scene="attic", dataset="folder", seed=seed)
    scores = "PSNR 20.00 dB, SSIM 0.800, LPIPS 0.200, time 0:06:00; no baseline was run, so it is compared with nothing"
    assert build_tables(tmp_path).findings == [f"TDg on attic: {scores}", CAPTURE]
    for seed in (0, 1):
        write(tmp_path, scene="cellar", dataset="folder", seed=seed)
    found = build_tables(tmp_path).findings
    assert found == [f"TDg on average over 2 scenes: {scores}", CAPTURE]
    assert (tmp_path / "tables" / "findings.txt").read_text(encoding="utf-8").splitlines() == found


@pytest.mark.parametrize(
    ("dataset", "said"),
    [("synthetic", "These scenes are built in, so this is no evidence on the paper's claims"),
     ("synthetic_degC", "These scenes are built in, so this is no evidence on the paper's claims"),
     ("ThermoScenes", CAPTURE)],
)  # fmt: skip
def test_other_data_sets(tmp_path, dataset, said):
    write(tmp_path, scene="attic", dataset=dataset)
    assert build_tables(tmp_path).findings[-1] == f"{said}, and one seed decides nothing: run `seed=0,1,2`"


def test_a_failed_cell_alone_finds_nothing(tmp_path):
    write(tmp_path, scene="attic", dataset="folder", status="failed", failure=Failure("train", "ValueError: no", ""))
    assert build_tables(tmp_path).findings == []


def test_an_ablation(tmp_path):
    write_ablation(tmp_path)
    Plan("ablation").write(tmp_path)
    assert build_tables(tmp_path).findings == [
        "TDg: PSNR 27.42 with colmap, 9.69 with random; SSIM 0.8899 with colmap, 0.3472 with random; one seed decides "
        "nothing",
        "MSMG: PSNR 27.18 with colmap, 9.64 with random; SSIM 0.8896 with colmap, 0.3471 with random; one seed decides "
        "nothing",
        "0 of 8 published scores reproduced, 8 undecided: run `seed=0,1,2`",
    ]
    for seed in (1, 2):
        for record in read_all(tmp_path):
            if record.seed == 0:
                write_record(tmp_path, record, {"seed": seed})
    found = build_tables(tmp_path).findings[0]
    assert found == (
        "TDg: PSNR 27.42 with colmap (best), 9.69 with random; SSIM 0.8899 with colmap (best), 0.3472 with random"
    )


def test_an_ablation_without_cells(tmp_path):
    Plan("ablation", PAPER, ["msmg", "tdg"], ["random", "colmap"]).write(tmp_path)
    assert build_tables(tmp_path).findings[0] == "TDg: n/a: no scene is on disk, or none was run"


def test_readings(tmp_path):
    psnr = {"3dgs": 20.0, "3dgs_smooth": 21.0, "tdg": 19.0, "msmg": 20.0, "msmg_thermal": 20.0}
    Plan("readings", variant_keys=["budget.iterations"]).write(tmp_path)
    for seed in (0, 1, 2):
        for method, value in psnr.items():
            noise = 0.01 * seed if method != "msmg_thermal" else (-1) ** seed
            write(tmp_path, method, "orbit", "synthetic", seed=seed, scores={"psnr": value + noise}, iterations=900)
    found = build_tables(tmp_path).findings
    assert "PSNR, dB, rises with smoothness, eq. 6, 900 iterations: +1.00 (+1.00 to +1.00)" in found
    assert any(text.startswith("PSNR, dB, falls with depth, as written, 900 iterations: -2.00 (") for text in found)
    assert "PSNR, dB: the 95 % interval contains 0 for 1 change" in found
    for record in read_all(tmp_path):
        assert record.failure is None


def test_readings_of_one_seed(tmp_path):
    Plan("readings").write(tmp_path)
    for method in ("3dgs", "3dgs_smooth"):
        write(tmp_path, method, "orbit", "synthetic", iterations=900)
    assert "PSNR, dB: no interval, of one seed, for 1 change: run `seed=0,1,2`" in build_tables(tmp_path).findings


def test_claims():
    verdicts = [
        ("TDg", HOLDS, UNDECIDED),
        ("TDg", HOLDS, HOLDS),
        ("TDg", FAILS, UNDECIDED),
        ("MMOne", UNDECIDED, FAILS),
    ]
    claims = [JudgedClaim("", "", "", paper, published, "", ours, "") for paper, published, ours in verdicts]
    assert claims_in_words(claims) == [
        "By the published tables, 2 of the paper's 3 claims hold, 1 fail, 0 are undecided",
        "By our results, 1 of the paper's 3 claims hold, 0 fail, 2 are undecided",
        "By our results, 0 of other papers' 1 claims hold, 1 fail, 0 are undecided",
    ]


def test_names_cannot_break_a_line(tmp_path):
    Plan("ablation").write(tmp_path)
    write(tmp_path, "a\nb", "orbit", "synthetic")
    assert any("a\\nb" in text for text in build_tables(tmp_path).findings)


def test_doubted_renders_are_marked_and_need_no_run_of_seeds(tmp_path):
    made, of_scene = {"files": "0" * 16, "summary": "made elsewhere by NeRF"}, "view007: far away"
    doubts = [of_scene, "nerf: 1 of 8 renders look more like their image mirrored (view005); flip them"]
    write(tmp_path, "nerf", "attic", "folder", doubts=doubts, has_doubts_of_its_own=True, made_elsewhere=made)
    alone = build_tables(tmp_path).findings
    assert alone[0].startswith("nerf (doubted: see the doubts) on attic: ") and "run `seed" not in alone[-1]
    assert "one seed decides nothing: score renders of further trainings, each with its `seed`" in alone[-1]
    write(tmp_path, "3dgs", "attic", "folder", doubts=[of_scene])
    *_, both, seeds = (line for line in build_tables(tmp_path).findings if "attic" in line or "one seed" in line)
    assert "nerf (doubted: see the doubts)" in both and "3DGS (doubted" not in both
    assert "run `seed=0,1,2`, and score renders of further trainings" in seeds
