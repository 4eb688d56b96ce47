"""Whether the rig pays: the trial's verdict, what it reads, and what a cell stores of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.setup import set_up
from tdgbench.cells.record import read_each
from tdgbench.training import trial
from tdgbench.training.trainer import Trainer
from tdgbench.training.trial import try_rig
from tdgbench.verify.cell import verify_cell
from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config

ENOUGH = "dataset.loader.views=16"


def configured(data_root, dataset: str, *overrides: str) -> DictConfig:
    cfg = config(f"dataset={dataset}", "scene=turntable", "method=3dgs", *QUICK, ENOUGH, *overrides)
    cfg.data.root = str(data_root)
    return cfg


def trainer_of(cfg: DictConfig, test_views=None) -> Trainer:
    scene = instantiate(cfg.dataset.loader).load("turntable")
    trainer = set_up(cfg, scene, compiles=False).trainer
    if test_views is not None:
        trainer.whole_context = replace(trainer.whole_context, scene=replace(scene, test=test_views))
    return trainer


def test_it_is_the_same_again_and_reads_no_test_view(data_root):
    cfg = configured(data_root, "synthetic_rig")
    trainer = trainer_of(cfg)
    found = try_rig(trainer.method, trainer.whole_context)
    blind = trainer_of(cfg, test_views=[])
    assert try_rig(blind.method, blind.whole_context) == found
    assert len(found.gains) == trial.FEWEST and "held-out training views" in found.reason


def test_a_gain_must_exceed_its_error_and_the_least_one(data_root, monkeypatch):
    """The verdict, with renders replaced by their PSNR: with the rig first, then without it."""
    trainer = trainer_of(configured(data_root, "synthetic"))
    for with_rig, pays in (
        ([21, 22, 23], True),
        ([20.2, 20.2, 20.2], False),
        ([20, 20, 26], False),
        ([17, 18, 19], False),
    ):
        psnrs = iter([*with_rig, 20, 20, 20])
        monkeypatch.setattr(Trainer, "psnr_of", lambda trainer, view, psnrs=psnrs: next(psnrs))
        assert try_rig(trainer.method, trainer.whole_context).pays is pays


def test_few_views_decide_nothing(data_root):
    cfg = configured(data_root, "synthetic")
    cfg.dataset.loader.views = 10
    trainer = trainer_of(cfg)
    found = try_rig(trainer.method, trainer.whole_context)
    assert not found.pays and found.gains == [] and "too few" in found.reason


@pytest.mark.parametrize("name", ["ommg", "thermonerf_thermal", "oezer_scratch"])
def test_a_method_that_cannot_learn_one_has_none(data_root, name):
    trainer = trainer_of(configured(data_root, "synthetic_rig", f"method={name}"))
    found = try_rig(trainer.method, trainer.whole_context)
    assert not found.pays and found.reason == "the method cannot learn one"


@pytest.mark.parametrize("pays", [True, False])
def test_a_cell_stores_the_verdict_and_verifies(data_root, tmp_path, monkeypatch, pays):
    cfg = configured(data_root, "synthetic", "thermal_camera.rig=auto")
    cfg.results = str(tmp_path)
    monkeypatch.setattr(trial, "GAIN", -100.0 if pays else 100.0)
    monkeypatch.setattr(trial, "_ERRORS", -100.0)
    assert run_quietly(cfg).status == "ok"
    ((folder, record),) = read_each(Path(cfg.results) / cfg.name)
    assert record.thermal_camera["rig"]["pays"] is pays and ("rig" in record.parts) is pays
    assert any(note.startswith("thermal camera: the rig is") for note in record.notes) and "rig" in record.seconds
    assert verify_cell(folder) == []


@pytest.mark.slow
@pytest.mark.parametrize(("dataset", "pays"), [("synthetic_rig", True), ("synthetic", False)])
def test_it_pays_where_there_is_a_rig_to_find(data_root, dataset, pays):
    size = (
        "dataset.loader.width=96",
        "dataset.loader.height=72",
        "dataset.loader.points=1000",
        "dataset.loader.views=30",
    )
    cfg = configured(data_root, dataset, *size, "budget=short")
    cfg.budget.iterations = 700
    trainer = trainer_of(cfg)
    assert try_rig(trainer.method, trainer.whole_context).pays is pays
