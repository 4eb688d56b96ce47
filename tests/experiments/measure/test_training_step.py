import time

from tdgbench.experiments.measure.training_step import PART_OF_MODULE, StepProfile, measure_step
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import step_rows
from tdgbench.splats.cpu.losses.minmax import normalise_rows
from tdgbench.splats.optimizer import Adam
from tests.helpers.configs import config
from tests.helpers.paths import ROOT


def test_a_part_within_another_counts_for_itself_only_and_functions_are_restored(monkeypatch):
    def step(self):
        time.sleep(0.02)
        pool.run(step_rows, [])

    def run(function, arguments):
        time.sleep(0.1)

    monkeypatch.setattr(Adam, "step", step)
    monkeypatch.setattr(pool, "run", run)
    profile = StepProfile()
    with profile.watch():
        Adam.step(None)
        pool.run(normalise_rows, [])
    assert 0.1 < profile.seconds["Adam"] < 0.2 and 0.1 < profile.seconds["losses"] < 0.2
    assert Adam.step is step and pool.run is run


def test_every_kernel_of_the_losses_has_a_part():
    modules = [path.stem for path in (ROOT / "tdgbench/splats/cpu/losses").glob("*.py")]
    with_kernels = [name for name in modules if f"losses.{name}" in PART_OF_MODULE]
    assert {"photometric", "smoothness", "minmax", "response"} <= set(with_kernels)


def test_a_refined_camera_has_a_part_of_its_own(tmp_path):
    cfg = config(
        "dataset=synthetic_degC", "dataset.loader.errors.camera.walk_degC=4", "dataset.loader.width=64",
        "dataset.loader.height=48", "dataset.loader.views=15", "dataset.loader.points=2500", "scene=turntable",
        "method=splat", "budget=demo", "camera=refined", f"data.root={tmp_path}",
    )  # fmt: skip
    parts = measure_step(cfg, 15).parts.set_index("part")["share"]
    assert 0 < parts["thermal camera"] < 0.5
