import numpy as np

from tdgbench.cells.record import Failure
from tdgbench.tables.build import build_tables
from tests.helpers.records import write


def test_missing_scenes_are_rows_and_averages_say_so(tmp_path):
    write(tmp_path)
    tables = build_tables(tmp_path)
    rows = tables.main[(tables.main["method"] == "tdg") & (tables.main["metric"] == "psnr")].set_index("scene")
    assert len(rows) == 14 + 2 + 1
    assert rows.loc["Truck", "value"] == 20
    assert np.isnan(rows.loc["Ebike", "value"]) and "not run" in rows.loc["Ebike", "reason"]
    assert rows["value"].drop("Truck").isna().all()
    text = (tmp_path / "tables" / "difference.csv").read_text()
    assert "tdg,RGBT-Scenes,day,Truck,psnr,20,26.28,-6.28," in text
    assert 'msmg,RGBT-Scenes,day,Truck,psnr,n/a,25.9,n/a,"not run' in text


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
