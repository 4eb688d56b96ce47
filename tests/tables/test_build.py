"""Tables of records: the published ones, ablations, splits, seeds, what is missing."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Failure, read_all
from tdgbench.tables.build import build_tables
from tdgbench.tables.measures import KEYS
from tdgbench.tables.published import published_main
from tdgbench.tables.tables_command import main
from tests.helpers.paths import ROOT
from tests.helpers.records import published_as_records, write, write_ablation


def test_the_published_numbers_give_the_published_table(published_tables):
    tables = published_tables
    found = tables.difference[~tables.difference["scene"].str.contains("Average")]
    assert found["difference"].abs().max() < 1e-9
    assert tables.difference["difference"].abs().max() < 0.006  # averages: rounding
    written = pd.read_csv(tables.folder / "main.csv", keep_default_na=False)
    assert f"\n{','.join(written.columns)}\n" in (ROOT / "docs" / "report.md").read_text(encoding="utf-8")
    paper = published_main()
    merged = written[written["metric"].isin(paper["metric"].unique())].merge(paper, on=KEYS, suffixes=("", "_paper"))
    assert len(merged) == len(paper)
    assert not written["bold"].any()  # of one seed
    for line in (
        r"\qquad Road Block & 26.51 & 0.921 & 0.221 & 0.388",
        r"26.73 & 0.921 & 0.212",
        r"\textbf{Average (Overall)} & 27.18 & 0.8896 & 0.177 & 0.389 & 27.42 & 0.8899",
    ):
        assert line in tables.latex


def test_verdicts_and_other_papers_stand_beside_the_published_numbers(tmp_path):
    for seed, psnr in enumerate((24.05, 24.06, 24.08)):
        write(tmp_path, "msmg", "Parterre", seed=seed, scores={"psnr": psnr})
    tables = build_tables(tmp_path)
    written = pd.read_csv(tmp_path / "tables" / "difference.csv", keep_default_na=False).set_index(KEYS)
    row = written.loc[("msmg", "RGBT-Scenes", "day", "Parterre", "psnr")]
    assert (row["verdict"], row["margin"], row["seeds_needed"], row["undecided_because"]) == (
        "reproduced",
        "0.2",
        "",
        "",
    )
    assert float(row["ci90_low"]) < 24.06 < float(row["ci90_high"])
    assert (row["others_low"], row["others_high"], row["papers"]) == ("26.16", "26.16", 2)
    assert written.loc[("tdg", "RGBT-Scenes", "day", "Parterre", "psnr"), "undecided_because"] == "no number of ours"
    papers = pd.read_csv(tmp_path / "tables" / "between_papers.csv")
    assert len(papers) == len(tables.papers) == 24


def test_an_average_over_other_scenes_is_not_the_paper_s(tmp_path):
    for seed in range(3):
        published_as_records(tmp_path, seed=seed)
        write(tmp_path, "tdg", "attic", "folder", seed=seed, scores={"psnr": 40.0})
        write(tmp_path, "msmg", "attic", "folder", seed=seed, scores={"psnr": 40.0})
    found = build_tables(tmp_path).difference.query("metric == 'psnr' and method == 'tdg'").set_index("scene")
    assert found.loc["Average (Overall)", "verdict"] == "undecided"
    assert found.loc["Average (Overall)", "reason"] == "our average is over other scenes than the paper's"
    assert set(found.drop("Average (Overall)")["verdict"]) == {"reproduced"}


def test_ablation(tmp_path):
    write_ablation(tmp_path)
    Plan("ablation").write(tmp_path)
    tables = build_tables(tmp_path)
    assert tables.difference["difference"].abs().max() < 1e-9 and len(tables.main) == 24
    assert r"TDg & $\times$ & $\checkmark$ & 27.42 / 0.8899 & 30.00 / 0.9000 & n/a / n/a \\" in tables.latex
    assert r"MSMG & $\checkmark$ & $\times$ & 9.64 / 0.3471 & 40.00 / 0.9000 & n/a / n/a \\" in tables.latex
    assert "% random: somewhere" in tables.latex
    assert (tables.main[tables.main["init"] == "random"]["points"] == "somewhere").all()
    assert (tables.difference["verdict"] == "undecided").all()


def test_an_ablation_compares_no_means_over_unequal_scenes(tmp_path):
    for init, scenes in (("colmap", {"orbit": 30.0, "night": 20.0}), ("random", {"orbit": 27.0})):
        for scene, psnr in scenes.items():
            write(tmp_path, scene=scene, dataset="synthetic", init=init, scores={"psnr": psnr})
    Plan("ablation").write(tmp_path)
    rows = build_tables(tmp_path).main.query("metric == 'psnr'").set_index("init")
    assert rows.loc["colmap", "value"] == 25 and np.isnan(rows.loc["random", "value"])
    assert rows.loc["random", "reason"] == "1 of 2 scenes are n/a"


def test_each_kind_of_random_points_is_held_against_the_published_one(tmp_path):
    write_ablation(tmp_path)
    for record in read_all(tmp_path):
        for init in ("random_box", "mvs_thermal") if record.init == "random" else ():
            write(
                tmp_path, record.method, record.scene, dataset=record.dataset, init=init,
                scores={**record.scores, "rgb_psnr": 12.5, "rgb_ssim": 0.5}, train_scores=record.train_scores,
            )  # fmt: skip
    Plan("ablation").write(tmp_path)
    tables = build_tables(tmp_path)
    found = tables.difference[tables.difference["metric"] == "psnr"].set_index(["method", "init"])
    assert set(found.index) == {(m, i) for m in ("tdg", "msmg") for i in ("random", "random_box", "colmap")}
    assert found.loc[("tdg", "random_box"), "published"] == found.loc[("tdg", "random"), "published"] == 9.69
    assert r"MSMG & $\checkmark$ (box) & $\times$ & 9.64 / 0.3471" in tables.latex and "12.50 / 0.5000" in tables.latex
    assert r"MSMG & $\checkmark$ (cameras)" in tables.latex
    assert r"MSMG & $\times$ & $\times$ (mvs\_thermal) & 9.64" in tables.latex  # no points of the paper's


def test_both_splits_in_one_sweep_are_told_apart(tmp_path):
    for split in ("eighty_twenty", "folder"):
        write(tmp_path, scene="orbit", dataset="synthetic", variant=f"data.split={split}", split=split)
    Plan("main", variant_keys=["data.split"]).write(tmp_path)
    tables = build_tables(tmp_path)
    assert set(tables.main["split"]) == {"eighty_twenty", "folder"}
    assert "split folder: the shipped train/ and test/ folders" in tables.latex
    assert not any(method == "tdg" for method in tables.main["method"])
    written = pd.read_csv(tmp_path / "tables" / "main.csv", keep_default_na=False)
    assert set(written["split"]) == {"eighty_twenty", "folder"}


def test_an_ablation_of_other_scenes_is_not_held_against_the_paper(tmp_path):
    for init in ("random", "colmap"):
        write(tmp_path, scene="orbit", dataset="synthetic", init=init)
    Plan("ablation").write(tmp_path)
    tables = build_tables(tmp_path)
    assert tables.difference is None and tables.main["value"].notna().any()


@pytest.mark.parametrize("kind", ["main", "ablation"])
def test_latex_compiles(tmp_path, kind):
    if shutil.which("pdflatex") is None:
        pytest.skip("pdflatex is not installed")
    published_as_records(tmp_path)
    write(tmp_path, scene="odd_name & co", dataset="synthetic", variant="a.b_c=1", channels=3)
    Plan(kind).write(tmp_path)
    build_tables(tmp_path)
    (tmp_path / "page.tex").write_text(
        r"\documentclass{article}\usepackage{booktabs,amssymb,graphicx}\begin{document}"
        r"\resizebox{\textwidth}{!}{\input{tables/main.tex}}"
        r"\end{document}"
    )
    run = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout[-2000:]


def test_command(tmp_path, capsys):
    write(tmp_path)
    assert main([str(tmp_path)]) == 0
    assert "Truck" in (printed := capsys.readouterr().out) and "no bold type" not in printed
    (tmp_path / "report.html").touch()
    assert main([str(tmp_path)]) == 0 and "still shows the tables of before" not in capsys.readouterr().out
    write(tmp_path, "msmg", config={"budget": {"name": "short", "iterations": 9}})
    assert main([str(tmp_path)]) == 0
    assert "report.html still shows the tables of before" in (printed := capsys.readouterr().out)
    assert "no bold type: it needs 3 seeds of each method" in printed
    assert main([str(tmp_path / "nothing")]) == 1
    assert "nothing is not there" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main([str(tmp_path / "empty")]) == 1
    assert "empty holds no records" in capsys.readouterr().err


def test_claims_command(tmp_path, capsys):
    write(tmp_path)
    assert main(["claims", str(tmp_path)]) == 0
    assert "fails" in (printed := capsys.readouterr().out) and "undecided" in printed
    claims = pd.read_csv(tmp_path / "tables" / "claims.csv").set_index("id")
    assert claims.loc["psnr-better", "published"] == "fails" and claims.loc["psnr-better", "ours"] == "undecided"
    assert main(["claims", str(tmp_path / "nothing")]) == 1


def test_missing_scenes_are_rows_and_averages_say_so(tmp_path):
    write(tmp_path)
    tables = build_tables(tmp_path)
    rows = tables.main[(tables.main["method"] == "tdg") & (tables.main["metric"] == "psnr")].set_index("scene")
    assert len(rows) == 14 + 2 + 1
    assert rows.loc["Truck", "value"] == 20
    assert np.isnan(rows.loc["Ebike", "value"]) and "no cell here: not run" in rows.loc["Ebike", "reason"]
    assert rows["value"].drop("Truck").isna().all()
    text = (tmp_path / "tables" / "difference.csv").read_text()
    assert "tdg,RGBT-Scenes,day,Truck,psnr,20,26.28,-6.28," in text
    assert 'msmg,RGBT-Scenes,day,Truck,psnr,n/a,25.9,n/a,"no cell here: not run' in text


def test_reasons_of_missing_metrics_and_failures(tmp_path):
    write(tmp_path, scene="orbit", dataset="synthetic", scores={"lpips": None}, missing={"lpips": "no backbone"})
    write(tmp_path, scene="night", dataset="synthetic", status="failed", failure=Failure("train", "boom", ""))
    tables = build_tables(tmp_path)
    rows = tables.main.set_index(["scene", "metric"])
    assert rows.loc[("orbit", "lpips"), "reason"] == "no backbone"
    assert rows.loc[("night", "psnr"), "reason"] == "failed in train: boom"
    assert np.isnan(rows.loc[("Average", "psnr"), "value"]) and tables.difference is None


def test_seeds_are_averaged_and_variants_kept_apart(tmp_path):
    for seed, value in ((0, 20.0), (1, 22.0)):
        write(tmp_path, scene="orbit", dataset="synthetic", seed=seed, scores={"psnr": value})
    write(tmp_path, scene="orbit", dataset="synthetic", variant="budget=demo", scores={"psnr": 10.0})
    write(tmp_path, scene="orbit", dataset="synthetic", init="random", scores={"psnr": 5.0})
    rows = build_tables(tmp_path).main.query("scene == 'orbit' and metric == 'psnr'").set_index("method")["value"]
    assert rows.to_dict() == {"tdg": 21.0, "tdg (random)": 5.0, "tdg [budget=demo]": 10.0}


def test_seeds_without_a_number_are_counted(tmp_path):
    for seed, psnr in enumerate((20.0, 21.0, None)):
        missing = {} if psnr else {"depth_abs_rel": "there is no true depth"}
        write(tmp_path, seed=seed, scores={"depth_abs_rel": psnr}, missing=missing)
    main = build_tables(tmp_path).main.set_index(["scene", "method", "metric"])
    row = main.loc[("Truck", "tdg", "depth_abs_rel")]
    assert np.isnan(row["value"]) and row["reason"] == "in 1 of 3 seeds there is no true depth"
