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
from tests.helpers.records import write, write_ablation

PAPER = [Description(s.name, DATASETS[s.dataset], s.group) for s in SCENES]


def test_the_published_table_in_words(published_tables):
    found = published_tables.findings
    assert found[0].startswith("TDg is better than MSMG on 10 of 14 scenes in PSNR (p = 0.045), 8 of 14 in SSIM (p = ")
    assert "14 of 14 in time (p < 0.001)" in found[0]
    assert found[0].endswith("; p: Wilcoxon's signed-rank test over the scenes")
    assert found[1].startswith("On average TDg has PSNR 27.42 against 27.18, SSIM 0.8899 against 0.8896, LPIPS 0.175 ")
    assert found[1].endswith("time 0:10:34 against 0:23:21")
    assert found[2].endswith("14 of 14 scenes agree within 10 %")
    assert found[3:] == ["0 of 102 published scores reproduced, 102 undecided: run `seed=0,1,2`"]
    assert (published_tables.folder / "findings.txt").read_text(encoding="utf-8").splitlines() == found


def test_they_count_what_the_tables_say(tmp_path):
    for seed in range(3):
        for method, psnr in (("tdg", 26.28), ("msmg", 20.0)):
            noise = 0.01 * seed if method == "tdg" else 1.0 * seed
            write(tmp_path, method, "Truck", seed=seed, scores={"psnr": psnr + noise, "lpips": None})
    tables = build_tables(tmp_path)
    verdicts = tables.difference.query("metric in ('psnr', 'ssim') and scene == 'Truck'")["verdict"].value_counts()
    assert tables.findings[0] == (
        "TDg is better than MSMG on 1 of 1 scenes in PSNR, 0 of 1 in SSIM, 0 of 1 in time; n/a on 13 more"
    )
    last = tables.findings[-1]
    assert last.startswith(f"{verdicts['reproduced']} of 4 published scores reproduced, ")
    assert all(f"{count} {word}" in last for word, count in verdicts.items() if word != "reproduced")
    assert last.endswith("(98 more have none of ours beside them)")


def test_built_in_scenes_are_no_evidence(tmp_path):
    for method in ("tdg", "msmg"):
        write(tmp_path, method, "orbit", dataset="synthetic", scores={"psnr": 30.0})
    assert build_tables(tmp_path).findings[-1] == (
        "These scenes are built in, so this is no evidence on the paper's claims, and one seed decides nothing: "
        "run `seed=0,1,2`"
    )
    for method in ("tdg", "msmg"):
        write(tmp_path, method, "orbit", dataset="synthetic", seed=1, scores={"psnr": 30.0})
    assert build_tables(tmp_path).findings[-1].endswith("no evidence on the paper's claims")


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
        "TDg against MSMG: n/a: no scene is on disk, or none was run",
        "Published scores: n/a: none of the 102 has one of ours beside it",
    ]
    write(tmp_path, "tdg", status="failed", failure=Failure("prior", "PriorError: no weights", ""))
    write(tmp_path, "msmg", "Lion", "ThermalMix", "360")
    assert build_tables(tmp_path).findings[0] == "TDg against MSMG: n/a: no scene has results of both"


def test_other_scenes_are_compared_too_but_with_no_paper(tmp_path):
    for scene in ("orbit", "night"):
        for method, psnr in (("tdg", 21.0), ("msmg", 20.0)):
            write(tmp_path, method, scene, "folder", scores={"psnr": psnr, "lpips": None})
    assert build_tables(tmp_path).findings == [
        "TDg is better than MSMG on 2 of 2 scenes in PSNR, 0 of 2 in SSIM, 0 of 2 in time",
        "On average TDg has PSNR 21.00 against 20.00, SSIM 0.800 against 0.800, time 0:06:00 against 0:06:00",
        f"{CAPTURE}, and one seed decides nothing: run `seed=0,1,2`",
    ]


CAPTURE = "These scenes are your capture, so no published score is beside them"


def test_a_capture_alone(tmp_path):
    for seed in (0, 1):
        write(tmp_path, scene="attic", dataset="folder", seed=seed)
    scores = "TDg has PSNR 20.00, SSIM 0.800, LPIPS 0.200, time 0:06:00"
    assert build_tables(tmp_path).findings == [f"{scores} on attic, with no baseline beside it", CAPTURE]
    for seed in (0, 1):
        write(tmp_path, scene="cellar", dataset="folder", seed=seed)
    found = build_tables(tmp_path).findings
    assert found == [f"{scores} on the average of 2 scenes, with no baseline beside it", CAPTURE]
    assert (tmp_path / "tables" / "findings.txt").read_text(encoding="utf-8").splitlines() == found


@pytest.mark.parametrize(
    ("dataset", "said"),
    [("synthetic_degC", "These scenes are built in, so this is no evidence on the paper's claims"),
     ("ThermoScenes", "No published score is beside these scenes")],
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
        "TDg, best points first: PSNR 27.42 with colmap, 9.69 with random; SSIM 0.8899 with colmap, 0.3472 with random",
        "MSMG, best points first: PSNR 27.18 with colmap, 9.64 with random; "
        "SSIM 0.8896 with colmap, 0.3471 with random",
        "0 of 8 published scores reproduced, 8 undecided: run `seed=0,1,2`",
    ]


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
    assert "PSNR, dB, rises with smoothness, eq. 6, 900 iterations: +1.00 [+1.00, +1.00]" in found
    assert any(text.startswith("PSNR, dB, falls with depth, as written, 900 iterations: -2.00 [") for text in found)
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
