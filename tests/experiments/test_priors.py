import hashlib

import numpy as np
import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.cells.record import Record, read_all
from tdgbench.experiments.matrix import MatrixCell
from tdgbench.experiments.prior_accuracy import PriorErrors
from tdgbench.experiments.priors import MeasuredScene, Priors, without_prior
from tests.helpers.command import command_here
from tests.helpers.configs import SMALL, config

FEW = ("budget.iterations=12", "study.scenes=[turntable]", "~study.priors.depth_anything", "~study.priors.marigold")


def overrides(tmp_path, data_root, *more):
    return ("+experiment=priors", *SMALL, f"data.root={data_root}", f"results={tmp_path}", *FEW, *more)


def test_errors_and_scores_of_every_prior(tmp_path, data_root, capsys):
    Priors().run(config(*overrides(tmp_path, data_root)))
    folder = tmp_path / "priors"
    table = pd.read_csv(folder / "priors.csv", keep_default_na=False).set_index("prior")
    assert list(table.index) == ["none", "synthetic", "sfm_points", "onnx"]
    errors = table.loc[["synthetic", "sfm_points"], ["abs_rel", "delta", "rank"]].astype(float)
    assert errors["abs_rel"].between(0.001, 0.5).all() and errors[["delta", "rank"]].gt(0.5).all(axis=None)
    assert errors.loc["synthetic", "abs_rel"] < errors.loc["sfm_points", "abs_rel"]
    assert list(table["truth"]) == ["", "true depth", "true depth", ""]
    assert list(table["made_from"]) == ["", "truth", "points", "thermal images"]
    assert table.loc["onnx", "psnr"] == "n/a" and table.loc["onnx", "reason"].endswith("it has no network")
    records = {record.variant: record for record in read_all(folder)}
    assert {v: r.method for v, r in records.items()} == {
        "prior=none": "3dgs_smooth", "prior=synthetic": "tdg", "prior=sfm_points": "tdg",
    }  # fmt: skip
    assert records["prior=none"].prior is None and records["prior=sfm_points"].prior["made_from"] == "points"
    for prior in ("synthetic", "sfm_points"):
        gain = records[f"prior={prior}"].scores["psnr"] - records["prior=none"].scores["psnr"]
        assert float(table.loc[prior, "psnr_gain"]) == pytest.approx(gain)
    views = pd.read_csv(folder / "priors_views.csv")
    means = views.groupby("prior")[["abs_rel", "delta", "rank"]].mean()
    assert len(views) == 16 and np.allclose(means.loc[errors.index], errors)
    said = capsys.readouterr().out
    assert "onnx on turntable: prior=onnx is not available" in said

    Priors().run(config(*overrides(tmp_path, data_root)))
    assert {record.variant: record.hashes for record in read_all(folder)} == {v: r.hashes for v, r in records.items()}


def test_tdg_without_a_prior_is_tdg_whose_depth_loss_has_no_weight(tmp_path, data_root):
    """The row `none` trains 3DGS with eq. 6: the same model, bit for bit, as TDg with λ_depth = 0.

    Errors are those of a prior that is trained with: its maps are made once.
    """
    few = ("~study.priors.onnx", "~study.priors.sfm_points", "method.method.lambda_depth=0", "study.seeds=[5]")
    Priors().run(config(*overrides(tmp_path, data_root, *few)))
    models = [
        hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted((tmp_path / "priors" / "cells").rglob("*.ply"))
    ]
    assert len(models) == 2 and models[0] == models[1]
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 8  # one for each view, of one seed


def test_without_a_prior_all_else_is_as_with_one():
    given = ("method.method.lambda_smooth=0.1", "method.method.smoothness_reading=released")
    cfg = config("+experiment=priors", "budget=paper", *given)
    without = cfg.copy()
    without.method = without_prior(cfg)
    assert without.method.name == "3dgs_smooth" and without.budget.iterations == cfg.budget.iterations == 10_000
    assert (without.method.method.lambda_smooth, without.method.method.smoothness_reading) == (0.1, "released")
    assert cfg.study.without.method.lambda_smooth == 0.6


def test_a_gain_is_of_all_seeds():
    """With one training less, also the one without a prior, there is none, and the table says why."""
    cfg = config("+experiment=priors", "study.seeds=[0,1]")
    cfg.study.priors = {"near": {}, "far": {}}
    psnr = {("none", 0): 20.0, ("none", 1): 22.0, ("near", 0): 23.0, ("near", 1): 24.0, ("far", 0): 19.0}

    def cells():
        for (prior, seed), value in psnr.items():
            one = Record("tdg", "synthetic", "orbit", "colmap", seed, "priors", prior, scores={"psnr": value})
            yield MatrixCell({"scene": "orbit", "prior": prior, "seed": seed}, cfg, None, one)

    study = Priors()
    study.measured = {"orbit": MeasuredScene("", {"near": PriorErrors(), "far": PriorErrors()})}
    table = study.tables(cfg, list(cells()))["priors"].set_index("prior")
    assert table.loc["near", "psnr_gain"] == 2.5 and table.loc["near", "reason"] == ""
    assert pd.isna(table.loc["far", "psnr_gain"]) and table.loc["far", "reason"] == "a training failed"
    del psnr["none", 1]
    table = study.tables(cfg, list(cells()))["priors"].set_index("prior")
    assert pd.isna(table.loc["near", "psnr_gain"]) and table.loc["near", "psnr"] == 23.5
    assert table.loc["near", "reason"] == "a training without a prior failed"


def test_another_method_needs_its_own_training_without_a_prior():
    with pytest.raises(OptionError, match=r"choose what Depth-prior NeRF is without: method@study.without=NAME"):
        without_prior(config("+experiment=priors", "method=depth_prior_nerf"))
    cfg = config("+experiment=priors", "method=depth_prior_nerf", "method@study.without=thermonerf_thermal")
    assert without_prior(cfg).name == "thermonerf_thermal"


@pytest.mark.slow
def test_a_scene_that_is_not_there_fails_alone(tmp_path, data_root):
    few = ("study.scenes=[nowhere,turntable]", "~study.priors.sfm_points")
    run = command_here(tmp_path, *overrides(tmp_path / "results", data_root, *few)[:-1], few[1])
    assert run.returncode == 1 and "failed: no synthetic scene nowhere" in run.stdout, run.stderr[-2000:]
    assert len(pd.read_csv(tmp_path / "results" / "priors" / "priors.csv")) == 3
