"""What every method must do, as nerfbaselines tests its own: a new one gets this test by its YAML file.

It is set up, trained, killed, resumed to the same bytes; its cell is run, stored, rendered again, scored.
"""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.setup import set_up
from tdgbench.cells.record import read_all, read_each
from tdgbench.training.loop import train
from tdgbench.training.part import Network
from tdgbench.training.skips import NO_GAUSSIANS
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer
from tdgbench.verify.cell import verify_cell
from tests.helpers.cells import run_quietly
from tests.helpers.configs import QUICK, config
from tests.helpers.page import Page
from tests.helpers.paths import ROOT
from tests.helpers.training import digest_of_all, train_killed

ITERATIONS = 24
KILLED_AFTER = (1, 11, 12, 18)  # 12: the first of two equal stages is over
OFTEN = (
    "budget.density.start=4", "budget.density.every=4", "budget.sh_every=6",
    "budget.density.opacity_reset_every=8", "budget.density.reset_recovery=1", f"budget.iterations={ITERATIONS}",
    "budget.density.max_gaussians=400",
    "budget.field.rays=64", "budget.field.samples=[8,8]", "budget.field.log2_rows=10",
)  # fmt: skip
UNTRAINED = {"renders", "model"}  # of files made elsewhere; their tests run and verify cells
PART_OF_ANOTHER = {"thermal3dgs_no_conduction"}  # a slow training without one of the other's parts
SHIPPED = sorted({path.stem for path in (ROOT / "conf/method").glob("*.yaml")} - UNTRAINED - PART_OF_ANOTHER)
FIELDS = {
    "thermonerf", "thermonerf_thermal", "oezer_scratch", "oezer_second_branch", "oezer_separate", "oezer_finetune",
    "depth_prior_nerf",
}  # without Gaussians  # fmt: skip
WORKED = ["gradient", "cooling", "one_geometry", "fine_tuned", "rig"]  # examples of docs/extending
OPTIONS = [
    "3dgs thermal_camera.rig=true",
    "msmg thermal_camera.rig=true",
    *(
        pytest.param(
            f"{name} budget=lean budget.settling.every=5 budget.settling.fewest=1 budget.settling.checks=1 "
            "budget.settling.slope_checks=99 budget.settling.full_after=0 "
            "budget.settling.tail=0.2",
            id=f"{name} budget=lean",
        )
        for name in ("mftg", "thermonerf_thermal", "oezer_finetune method.method.rgb_share=0.5")
    ),
]  # that change parts


@pytest.fixture
def configured(tmp_path, monkeypatch, data_root):
    """Return the configuration of a method, of `conf/method/` or of a worked example, and overrides after its name."""
    pages = []

    def configure(words: str) -> DictConfig:
        name, *overrides = words.split()
        known = name if name in SHIPPED else "3dgs"
        cfg = config(f"method={known}", "scene=turntable", *QUICK, *OFTEN, *overrides)
        cfg.data.root, cfg.results = str(data_root), str(tmp_path / "results")
        if name not in SHIPPED:
            pages.extend(Page(page, tmp_path, monkeypatch) for page in ("method", "parts"))
            cfg.method = OmegaConf.load(tmp_path / f"yaml/method/{name}.yaml")
        return cfg

    yield configure
    for page in pages:
        page.forget_modules()


@pytest.fixture
def rendered(monkeypatch) -> set[tuple[int, bool]]:
    """Note how many channels the renders of Gaussians have, and whether they have depth with a gradient."""
    found, render = set[tuple[int, bool]](), SplatModel.render

    def noted(model, *args, depth=False, **options):
        result = render(model, *args, depth=depth, **options)
        found.add((result.image.shape[2], depth and torch.is_grad_enabled()))
        return result

    monkeypatch.setattr(SplatModel, "render", noted)
    return found


@pytest.mark.parametrize("name", [*SHIPPED, *WORKED, *OPTIONS])
def test_a_killed_training_resumes_to_the_same_bytes(configured, small_gray_scene, tmp_path, name, rendered):
    """A trainer that is let go leaves nothing. All that is rendered has kernels that are compiled before the clock."""
    cfg = configured(name)
    calm = set_up(cfg, small_gray_scene, compiles=False).trainer
    log = train(calm)
    assert {count for count, _ in rendered} <= calm.method.rendered_channels(small_gray_scene)
    assert calm.method.loss_takes_depth or not any(takes_depth for _, takes_depth in rendered)
    assert log.ended and log.iterations == ITERATIONS
    trainer, again = train_killed(
        lambda: set_up(cfg, small_gray_scene, compiles=False).trainer, tmp_path / "a.pt", KILLED_AFTER
    )
    assert again.resumed == list(KILLED_AFTER)
    assert [line.loss for line in again.lines] == [line.loss for line in log.lines]
    assert digest_of_all(trainer) == digest_of_all(calm)
    rows = weakref.ref(_memory_of(calm))
    del calm
    gc.collect()
    assert rows() is None


def _memory_of(trainer: Trainer) -> torch.Tensor:
    """Return the largest tensor of what the trainer renders: its thermal Gaussians, or a network."""
    if "thermal" in trainer.gaussians:
        return trainer.gaussians["thermal"].state._values
    (network,) = (part for part in trainer.parts.values() if isinstance(part, Network))
    return max(network.module.parameters(), key=torch.numel)


@pytest.mark.parametrize("name", [*SHIPPED, *WORKED, *OPTIONS])
def test_a_cell_is_stored_rendered_again_scored_and_removed(configured, name):
    cfg = configured(name)
    outcome = run_quietly(cfg)
    assert outcome.status == "ok", outcome.message
    ((folder, record),) = read_each(Path(cfg.results) / cfg.name)
    assert record.method == cfg.method.name and record.scores["psnr"] > 5
    if name.split()[0] in FIELDS:
        assert not record.gaussians and record.missing["gaussians"] == NO_GAUSSIANS
        assert not list(folder.glob("*.ply")) and record.parts["field"]["parameters"] > 1000
    else:
        assert record.gaussians["thermal"] > 0
    assert verify_cell(folder) == []
    assert run_quietly(cfg).status == "kept"
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()
    assert read_all(Path(cfg.results) / cfg.name) == []


def test_stages_settle_by_their_own_images(configured, small_gray_scene):
    """With rules that look at held-out views, also a stage that trains on RGB; what was left out is counted in both."""
    rules = "budget.settling.every=5 budget.settling.fewest=1 budget.settling.checks=1 budget.settling.slope_checks=2 "
    rules += (
        "budget.settling.full_after=0 budget.settling.since=0 budget.settling.gain=50 budget.settling.most_growth=50"
    )
    cfg = configured(f"fine_tuned budget=lean {rules} budget.pixels.smallest_side=8 budget.iterations=120")
    outcome = run_quietly(cfg)
    assert outcome.status == "ok", outcome.message
    ((folder, record),) = read_each(Path(cfg.results) / cfg.name)
    skips = {skip["name"]: skip for skip in record.skips}
    assert skips["settling"]["taken"] and record.iterations < 100
    assert record.parts["rgb/curriculum"]["settled_at"] > 0 and record.parts["curriculum"]["settled_at"] > 0
    small = [sum(int(report["iterations"].get(f"1/{scale}", 0)) for scale in (2, 3, 4, 6, 8)) for report in
             (record.parts["rgb/curriculum"], record.parts["curriculum"])]  # fmt: skip
    assert sum(int(words.split()[0]) for words in skips["pixels"]["reason"].split(", ")) == sum(small) > max(small)
    assert verify_cell(folder) == []


def test_the_parts_of_another_method_are_refused(configured, small_gray_scene):
    """A cell whose stored parts were exchanged is told, and not rendered with half of them."""
    cfg = configured("rig")
    run_quietly(cfg)
    ((folder, _),) = read_each(Path(cfg.results) / cfg.name)
    torch.save({"other": {}}, folder / "parts.pt")
    assert any("does not hold the parts of rig" in problem for problem in verify_cell(folder))
    (folder / "parts.pt").write_bytes(b"\x80\x04cos\nsystem\n")
    assert any("does not hold the parts of rig" in problem for problem in verify_cell(folder))
