"""Trainings in stages: what each one gets, what a checkpoint keeps, and what the frames of a scene are."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from tdgbench.training.budget import PlateauRule
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.images import THERMAL
from tdgbench.training.loop import train
from tdgbench.training.method import Method, Stage, Step
from tdgbench.training.part import NonFiniteError, Part
from tdgbench.training.plateau import Plateau
from tdgbench.training.trainer import Trainer
from tests.helpers.training import ready_to_train

ITERATIONS = 60
OFTEN = (
    "budget.density.start=8", "budget.density.every=8", "budget.density.opacity_reset_every=1000", "budget.sh_every=9",
    "budget.density.grad_threshold=1e-5", "budget.density.round_recovery=0", "budget.plateau=null",
)  # fmt: skip


class CoarseToFine(Method):
    """3DGS for a third of the iterations, then from its Gaussians on, with a network that scales its images."""

    def stages(self) -> list[Stage]:
        return [
            Stage("coarse", self.set_up_coarse, self.coarse_step, 1 / 3),
            Stage("fine", self.set_up_fine, self.fine_step, 2 / 3),
        ]

    def set_up_coarse(self, context) -> None:
        self.model, self.views = context.gaussians(), context.views()
        self.exposure = None

    def coarse_step(self, iteration: int) -> Step:
        view = self.views.next()
        return self.compared(self.model.render(view.camera), view)

    def set_up_fine(self, context) -> None:
        self.start = self.model.copy()
        self.model = context.gaussians(start=self.start)
        self.views = context.add_part("views", self.views)
        self.exposure = context.network("exposure", self.exposure_module(), 1e-2)

    def exposure_module(self) -> torch.nn.Module:
        module = torch.nn.Linear(1, 1)
        torch.nn.init.ones_(module.weight)
        torch.nn.init.zeros_(module.bias)
        return module

    def fine_step(self, iteration: int) -> Step:
        view = self.views.next()
        render = self.model.render(view.camera)
        render.image = self.exposure.module(render.image)
        return self.compared(render, view)

    def compared(self, render, view) -> Step:
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = (render.image - target).square().mean()
        return Step(loss, {"thermal": loss.item()}, render, target, valid)


def two_stages(scene, *overrides: str) -> Trainer:
    return ready_to_train(scene, "3dgs", ITERATIONS, *OFTEN, *overrides, method=CoarseToFine())


def test_a_stage_starts_from_the_gaussians_of_the_one_before(small_gray_scene):
    trainer, seen = two_stages(small_gray_scene), {}

    def look(log):
        seen[log.iterations] = trainer.stage.name, trainer.gaussians["thermal"].copy()

    before = len(trainer.gaussians["thermal"])
    log = train(trainer, before_update=look)
    assert log.iterations == ITERATIONS and log.ended
    assert [seen[i][0] for i in (1, 20, 21, 60)] == ["coarse", "coarse", "fine", "fine"]
    coarse, fine, last = (seen[i][1] for i in (20, 21, 60))
    assert before < len(coarse) < len(last)  # density control had its schedule in each stage
    for (name, a), (_, b) in zip(coarse.items(), fine.items(), strict=True):
        assert sorted(a.flatten(1).tolist() if a.ndim > 1 else a.tolist()) == sorted(
            b.flatten(1).tolist() if b.ndim > 1 else b.tolist()
        ), name  # rows have an order of their own


def test_parts_of_a_finished_stage_are_kept_and_reported(small_gray_scene):
    trainer = two_stages(small_gray_scene)
    assert list(trainer.all_parts()) == ["curriculum", "thermal", "views"]
    first = trainer.parts
    train(trainer)
    assert list(trainer.all_parts()) == [
        "coarse/curriculum", "coarse/thermal", "curriculum", "thermal", "views", "exposure",
    ]  # fmt: skip
    assert trainer.all_parts()["coarse/thermal"] is first["thermal"] and trainer.parts["views"] is first["views"]
    reports = trainer.reports()
    assert reports["exposure"] == {"parameters": 2} and "views" not in reports
    assert reports["thermal"]["gaussians"] > reports["coarse/thermal"]["gaussians"]
    assert list(trainer.gaussians) == ["thermal"]


def test_a_state_of_another_stage_starts_the_first_one_again_where_it_does_not_fit(small_gray_scene, tmp_path):
    """A checkpoint in the second stage of a method that has only one now."""
    trainer = two_stages(small_gray_scene)
    checkpoint = Checkpoint(tmp_path / "a.pt", {}, 0.0)
    log = train(trainer, log=checkpoint.resume(trainer))
    checkpoint.write_if_due(log)
    other = ready_to_train(small_gray_scene, "3dgs", ITERATIONS, *OFTEN)
    checkpoint = Checkpoint(tmp_path / "a.pt", {}, 0.0)
    assert checkpoint.resume(other).iterations == 0 and other.stage_number == other.stage_start == 0
    assert checkpoint.notes == ["a checkpoint was not used: there is no stage 1"]


def test_a_rule_of_the_budget_ends_each_stage(small_gray_scene):
    """Iterations of a stage that ended early are not given to the next one."""
    trainer = two_stages(small_gray_scene, "budget.density.start=1000")
    trainer.stopping = Plateau(PlateauRule(epochs=1, patience=1, gain=0.9, after=0), views=5)
    log = train(trainer)
    assert trainer.stage_start == 10 and log.iterations == 10 + 40 and trainer.stopping is None


def test_a_gradient_of_a_network_that_is_not_finite_names_part_and_parameter(small_gray_scene, monkeypatch):
    trainer = two_stages(small_gray_scene)
    module = CoarseToFine().exposure_module()
    module.weight.register_hook(lambda grad: grad * torch.nan)
    monkeypatch.setattr(trainer.method, "exposure_module", lambda: module)
    with pytest.raises(NonFiniteError, match="gradient of exposure weight is not finite"):
        train(trainer)


def test_frames_are_numbered_and_timed_in_the_order_of_names(small_scene):
    frames = ready_to_train(small_scene, "3dgs", 3).context.frames
    assert list(frames) == sorted(view.name for view in small_scene.views)
    assert [frame.index for frame in frames.values()] == list(range(len(frames)))
    times = [frame.time for frame in frames.values()]
    assert times[0] == 0.0 and times[-1] == 1.0 and times == sorted(times)


def test_numbers_among_names_are_times_with_their_gaps(small_scene):
    context = ready_to_train(small_scene, "3dgs", 3).context
    views = [replace(view, name=name) for view, name in zip(small_scene.views, ("10", "2", "5"), strict=False)]
    scene = replace(small_scene, train=views, test=[])
    frames = replace(context, scene=scene).frames
    found = [(name, frame.index, frame.time) for name, frame in frames.items()]
    assert found == [("2", 0, 0), ("5", 1, 0.375), ("10", 2, 1)]
    views = [
        replace(view, name=name) for view, name in zip(views, ("20240806235959", "20240807000000", "1"), strict=True)
    ]
    frames = replace(context, scene=replace(scene, train=views)).frames
    assert [(name, frame.time) for name, frame in frames.items()][1] == ("20240806235959", 0.5)


def test_a_frame_has_the_camera_of_the_view_that_is_given(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    view = small_gray_scene.train[1]
    small = type(view)(view.name, view.camera.resized(24, 18), view.load_thermal)
    frame = trainer.context.frame(small)
    assert frame.camera is small.camera and frame.index == trainer.context.frame(view).index


def test_radiance_fields_check_some_pixels_and_keep_their_resolution(small_gray_scene, monkeypatch):
    trainer = ready_to_train(
        small_gray_scene, "thermonerf_thermal", 20, "budget=lean", "budget.iterations=20", "budget.field.rays=64",
        "budget.pixels.smallest_side=8", "budget.settling.fewest=1", "budget.settling.every=5",
        "budget.settling.full_after=0",
    )  # fmt: skip
    trainer.method.pixels_of_check, asked = 50, []
    some = trainer.method.render_pixels
    monkeypatch.setattr(trainer.method, "render_pixels", lambda *words: asked.append(words) or some(*words))
    monkeypatch.setattr(trainer.method, "render", None)
    train(trainer)
    curriculum = trainer.context.curricula["thermal"]
    assert curriculum.iterations == {1: 20} and [check[0] for check in curriculum.checks] == [5, 10, 15]
    assert len(asked) == 3 and all(torch.equal(pixels, asked[0][1]) for _, pixels, _ in asked)
    monkeypatch.undo()
    view = curriculum.held_out[0]
    trainer.method.pixels_of_check = view.camera.width * view.camera.height
    of_all = trainer.psnr_of(view)
    trainer.method.pixels_of_check = None
    assert of_all == pytest.approx(trainer.psnr_of(view), abs=1e-5)


def test_parts_of_each_finished_stage_have_a_name(small_gray_scene):
    trainer = ready_to_train(small_gray_scene, "3dgs", 3)
    parts = [Part() for _ in range(4)]
    trainer._finished = [("a", "x", parts[0]), ("a", "thermal", parts[1]), ("b", "x", parts[2]), ("b", "y", parts[3])]
    found = trainer.all_parts()
    assert [found[name] for name in ("a/x", "a/thermal", "x", "y")] == parts
    assert list(found)[:4] == ["a/x", "a/thermal", "x", "y"] and found["thermal"] is trainer.parts["thermal"]
