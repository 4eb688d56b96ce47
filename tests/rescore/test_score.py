"""`tdgbench score`: the same scores as a training by the other protocol gives, and nothing is computed twice."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from tdgbench.cells.cell_tables import read_views
from tdgbench.cells.folder import hashes_below
from tdgbench.cells.metric_settings import metric_settings, scorer_of
from tdgbench.cells.paths import RECORD_FILE
from tdgbench.cells.plan import PLAN_FILE
from tdgbench.cells.protocol import protocol_of
from tdgbench.cells.record import Record, read_all, read_record
from tdgbench.packs import pack
from tdgbench.rescore import cell as rescore_cell
from tdgbench.rescore.command import main, read_options
from tdgbench.scoring import METRICS, RenderedImages, Scorer
from tdgbench.scoring.metric import ImageMetric, ViewMetric
from tdgbench.verify import verify
from tests.helpers.cells import run_quietly
from tests.helpers.configs import SMALL, config
from tests.scoring.weights import random_state

MSMG = "cells/msmg/synthetic/turntable/colmap/seed0"
OFFLINE = "metrics.lpips.download=false"


@pytest.fixture
def experiment(small_results, tmp_path) -> Path:
    return Path(shutil.copytree(small_results, tmp_path / "a"))


@pytest.fixture
def msmg(experiment) -> Path:
    """The experiment with its cell of MSMG alone."""
    for folder in (experiment / "cells").iterdir():
        if folder.name != "msmg":
            shutil.rmtree(folder)
    return experiment


def record_of(folder: Path) -> Record:
    record = read_record(folder)
    assert record is not None
    return record


def score(experiment: Path, name: str, *options: str) -> int:
    return main([str(experiment), str(experiment.with_name(name)), *options])


def test_it_gives_what_a_training_gives(data_root, tmp_path):
    """By the other protocol from the start, of a method with images and a second modality."""
    common = (*SMALL, "budget=demo", "budget.iterations=12", "scene=turntable", "method=msmg", "prior=synthetic",
              f"data.root={data_root}", f"results={tmp_path}")  # fmt: skip
    for name, options in (("a", ()), ("c", ("metrics=standard",))):
        cfg = config(*common, f"name={name}", *options)
        assert run_quietly(cfg).status == "ok"
    assert score(tmp_path / "a", "b", "metrics=standard", OFFLINE) == 0
    a, b, trained = (record_of(tmp_path / name / MSMG) for name in "abc")
    assert b.protocol == trained.protocol == protocol_of(b.config) != a.protocol
    assert (b.key, b.convention, b.scores, b.experiment) == (trained.key, "standard", trained.scores, "b")
    assert b.scores["ssim"] != a.scores["ssim"] and read_views(tmp_path / "b" / MSMG) == read_views(
        tmp_path / "c" / MSMG
    )
    assert b.train_scores == {"psnr": a.train_scores["psnr"], "ssim": None}
    assert b.missing["train_ssim"] == "renders of training views are not stored"
    assert b.notes[-1] == f"scored again: protocol {b.protocol}, trained with {a.protocol}"
    assert verify(tmp_path / "b").problems == []


def test_an_experiment_keeps_its_scores_and_failures(experiment, capsys):
    before = {path: path.read_bytes() for path in experiment.rglob("*.*") if path.is_file()}
    assert score(experiment, "b", "metrics=standard", OFFLINE) == 0
    assert {path: path.read_bytes() for path in before} == before
    out = experiment.with_name("b")
    assert [r.why_failed for r in read_all(out)] == [r.why_failed for r in read_all(experiment)]
    assert (out / "tables" / "main.csv").exists() and (out / "report.html").exists()
    assert verify(out).problems == []
    assert "ssim, rgb_ssim computed; lpips, rgb_lpips n/a (no vgg backbone: " in capsys.readouterr().out


def test_what_is_there_is_not_computed_again(experiment, monkeypatch, capsys):
    weights = experiment.with_name("squeeze.pth")
    torch.save({f"features.{name}": value for name, value in random_state("squeeze").items()}, weights)
    words = ("metrics.lpips.net=squeeze", f"metrics.lpips.weights={weights}")
    assert score(experiment, "b", *words) == 0
    out = experiment.with_name("b")
    assert record_of(out / MSMG).scores["lpips"] > 0 and verify(out, weights=weights).problems == []
    monkeypatch.setattr(Scorer, "lpips", lambda *_: pytest.fail("scored again"))
    monkeypatch.setattr(rescore_cell, "_write", lambda *_: pytest.fail("written again"))
    capsys.readouterr()
    assert score(experiment, "b", *words) == 0
    assert capsys.readouterr().out.count("already there") == 3


def test_without_weights_lpips_is_tried_again(msmg):
    assert score(msmg, "b") == 0  # nothing is downloaded for a cell without LPIPS
    first = record_of(msmg.with_name("b") / MSMG)
    assert "download is false; set it true" in first.missing["lpips"]
    assert first.scores["lpips"] is None and first.protocol == record_of(msmg / MSMG).protocol
    weights = msmg.with_name("vgg.pth")
    torch.save({f"features.{name}": value for name, value in random_state("vgg").items()}, weights)
    assert score(msmg, "b", f"metrics.lpips.weights={weights}") == 0
    assert record_of(msmg.with_name("b") / MSMG).scores["lpips"] > 0


def brightness(name: str, kind: type = ImageMetric):
    common = {"name": name, "label": name, "order": 500}
    if kind is ImageMetric:
        return ImageMetric(of_images=lambda pair: float(pair.image.mean()), **common)
    return ViewMetric(of_view=lambda shown: float(shown.rendered.known_depth.mean()), **common)


def test_a_new_metric_is_added_alone(msmg, monkeypatch):
    """Of pictures, and of the model's depth; the others keep their values, also those that no file gives."""
    new = {m.name: m for m in (brightness("brightness"), brightness("mean_depth", ViewMetric))}
    assert "psnr_true" in METRICS
    for name, metric in new.items():
        monkeypatch.setitem(METRICS, name, metric)
    assert score(msmg, "b") == 0
    before, after = (record_of(folder / MSMG) for folder in (msmg, msmg.with_name("b")))
    assert after.scores.keys() - before.scores.keys() == new.keys()
    assert {name: after.scores[name] for name in before.scores} == before.scores
    assert (after.protocol, after.key, after.train_scores) == (before.protocol, before.key, before.train_scores)
    assert 0 < after.scores["brightness"] < 1 < after.scores["mean_depth"]


def test_with_another_number_all_is_computed_from_the_files(msmg, monkeypatch):
    """True depths are no files of a cell."""
    before = record_of(msmg / MSMG)
    monkeypatch.setattr(rescore_cell, "VERSION", 2)
    monkeypatch.setattr(rescore_cell, "protocol_of", lambda config: protocol_of(config, 2))
    assert score(msmg, "b", OFFLINE) == 0
    after = record_of(msmg.with_name("b") / MSMG)
    assert after.protocol == before.protocol.replace("1-", "2-")
    assert after.scores["depth_abs_rel"] is None and before.scores["depth_abs_rel"] is not None
    for name in ("psnr", "ssim", "mae_degC", "channel_psnr", "depth_inconsistency", "barely_seen"):
        assert after.scores[name] == pytest.approx(before.scores[name], rel=1e-4), name


def test_options_that_are_not_named_stay_those_of_the_cell(msmg, tmp_path, monkeypatch):
    """A cell of SqueezeNet that gets a metric more keeps its LPIPS; the file that its record names is not opened."""
    weights = tmp_path / "squeeze.pth"
    torch.save({f"features.{name}": value for name, value in random_state("squeeze").items()}, weights)
    assert score(msmg, "b", "metrics=standard", "metrics.lpips.net=squeeze", f"metrics.lpips.weights={weights}") == 0
    squeeze = record_of(msmg.with_name("b") / MSMG)
    elsewhere = weights.rename(tmp_path / "moved.pth")
    (tmp_path / "own_metrics.py").write_text(
        "from tdgbench.scoring.metric import ImageMetric\n"
        "MEAN = ImageMetric(name='mean', label='mean', order=500, of_images=lambda pair: float(pair.image.mean()))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert score(msmg.with_name("b"), "c", "metrics.extra=[own_metrics.MEAN]") == 0
    both = record_of(msmg.with_name("c") / MSMG)
    assert both.scores.pop("mean") > 0 and both.scores == squeeze.scores
    assert (both.convention, both.setting("metrics.lpips")) == ("standard", squeeze.setting("metrics.lpips"))
    assert score(msmg.with_name("b"), "d", f"metrics.lpips.weights={elsewhere}") == 0
    moved = record_of(msmg.with_name("d") / MSMG)
    assert moved.setting("metrics.lpips.net") == "squeeze" and moved.scores == squeeze.scores
    chosen = read_options(["metrics.lpips.net=vgg"]).of_cell(squeeze.setting("metrics"))
    assert chosen["convention"] == "standard" and chosen["lpips"] == read_options(["metrics=3dgs"]).metrics["lpips"]


def test_of_other_programs_renders_there_is_no_model(msmg, monkeypatch):
    folder = msmg / MSMG
    content = json.loads((folder / RECORD_FILE).read_text())
    content["parts"] = {}
    (folder / RECORD_FILE).write_text(json.dumps(content))
    monkeypatch.setitem(METRICS, "mean_depth", brightness("mean_depth", ViewMetric))
    assert score(msmg, "b") == 0
    after = record_of(msmg.with_name("b") / MSMG)
    assert after.scores["mean_depth"] is None and "no model" in after.missing["mean_depth"]


def test_a_pack_is_scored(msmg, tmp_path):
    path, _ = pack(msmg, tmp_path / "a.zip", keep_paths=True)
    assert main([str(path), str(tmp_path / "b"), "metrics=standard", OFFLINE]) == 0
    assert verify(tmp_path / "b").problems == []


def test_changed_renders_are_refused(experiment, capsys):
    render = next((experiment / MSMG / "renders").glob("*.png"))
    render.write_bytes(render.read_bytes() + b"x")
    assert score(experiment, "b", "metrics=standard", OFFLINE) == 1
    assert f"not scored: renders/{render.name} has changed; see tdgbench verify" in capsys.readouterr().out
    assert not (experiment.with_name("b") / MSMG).exists() and len(read_all(experiment.with_name("b"))) == 3


def test_another_training_is_not_replaced(msmg, capsys):
    other = Path(shutil.copytree(msmg, msmg.with_name("b")))
    content = json.loads((other / MSMG / RECORD_FILE).read_text())
    content["hashes"]["model.ply"] = "0" * 64
    (other / MSMG / RECORD_FILE).write_text(json.dumps(content))
    before = (other / MSMG / RECORD_FILE).read_bytes()
    assert score(msmg, "b", OFFLINE) == 1
    assert "holds another training; name a new folder" in capsys.readouterr().err
    assert (other / MSMG / RECORD_FILE).read_bytes() == before


def test_a_finished_training_of_another_experiment_stays_as_it_is(msmg, capsys):
    """The other experiment's cell has failed, or it has no such cell."""
    failed = Path(shutil.copytree(msmg, msmg.with_name("failed")))
    content = json.loads((failed / MSMG / RECORD_FILE).read_text())
    content |= {"status": "failed", "failure": {"phase": "train", "error": "no", "traceback": ""}, "seed": 0}
    finished = failed / MSMG.replace("seed0", "seed1")
    shutil.copytree(failed / MSMG, finished)
    (failed / MSMG / RECORD_FILE).write_text(json.dumps(content))
    (finished / RECORD_FILE).write_text((msmg / MSMG / RECORD_FILE).read_text().replace('"seed": 0', '"seed": 1'))
    other = Path(shutil.copytree(msmg, msmg.with_name("b")))
    (other / PLAN_FILE).write_text("{}")
    before = hashes_below(other)
    assert score(failed, "b", OFFLINE) == 1
    assert "holds another training; name a new folder" in capsys.readouterr().err
    assert hashes_below(other) == before and (other / PLAN_FILE).read_text() == "{}"


def test_weights_that_were_replaced_are_refused(msmg, capsys, monkeypatch):
    weights = msmg.with_name("squeeze.pth")
    torch.save({f"features.{name}": value for name, value in random_state("squeeze").items()}, weights)
    assert score(msmg, "b", "metrics.lpips.net=squeeze", f"metrics.lpips.weights={weights}") == 0
    assert verify(msmg.with_name("b"), weights=weights).problems == []
    weights.write_bytes(b"another")
    os.utime(weights, (1, 1))
    problems = verify(msmg.with_name("b"), weights=weights).problems
    assert any("squeeze.pth is not the file that the scores were made with" in problem for problem in problems)
    monkeypatch.setattr(rescore_cell, "VERSION", 2)  # so that all is computed again
    assert score(msmg.with_name("b"), "c") == 0
    again = record_of(msmg.with_name("c") / MSMG)
    assert again.scores["lpips"] is None and "a file of its own, squeeze.pth; name it" in again.missing["lpips"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["data.width=64"], "data.width=64 decides what is read or trained"),
        (["metrics=mine"], "metrics=mine: there is no such metrics (there are 3dgs, standard)"),
        (["metrics.border=valid"], "border"),
        (["metrics.ssim_border=wide"], "metrics.ssim_border"),
    ],
)
def test_other_options_are_refused(words, why, experiment, capsys):
    assert score(experiment, "b", *words) == 1
    assert why in capsys.readouterr().err and not experiment.with_name("b").exists()


def test_its_own_folder_and_empty_ones_are_refused(experiment, tmp_path, capsys):
    assert main([str(experiment), str(experiment)]) == 1 and "name another folder" in capsys.readouterr().err
    assert main([str(tmp_path / "none"), str(tmp_path / "b")]) == 1 and "is not there" in capsys.readouterr().err


def test_metrics_name_the_options_that_they_depend_on(small_scene, monkeypatch):
    """A value that changes without its metric naming the option would be taken over."""
    rng = np.random.default_rng(0)
    renders = {
        view.name: RenderedImages(
            np.clip(view.thermal + rng.normal(0, 0.1, view.thermal.shape), 0, 1).astype(np.float32), view.true_depth,
            {"rgb": view.rgb * np.float32(0.9)}, determinacy=rng.random(view.thermal.shape[:2]).astype(np.float32),
        )
        for view in small_scene.test
    }  # fmt: skip
    monkeypatch.setattr("tdgbench.scoring.lpips.trunk_weights", lambda net, *_: random_state(net))
    scored = []
    for words in ([], ["metrics=standard"]):
        scorer = scorer_of(metric_settings(read_options([*words, "metrics.lpips.net=squeeze"]).metrics))
        scored.append(scorer.score(small_scene, renders)[small_scene.test[0].name])
    changed = {name for name in METRICS if scored[0][name] != scored[1][name]}
    options = {"ssim_border", "lpips_range"}
    assert changed == {name for name, metric in METRICS.items() if options & {*metric.options}} != set()
