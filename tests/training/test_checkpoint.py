import hashlib
import io
import os
import random
from pathlib import Path

import pytest
import torch

from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.images import THERMAL
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.losses import photometric
from tdgbench.training.method import Method, Stage, Step
from tdgbench.training.trainer import Trainer
from tests.helpers.training import KilledError, ready_to_train, train_killed
from tests.helpers.training import digest_of_all as digest

ITERATIONS = 60
OFTEN = (  # with a plateau that is watched but never reached
    "budget.density.start=10", "budget.density.every=10", "budget.density.opacity_reset_every=25",
    "budget.density.reset_recovery=1", "budget.sh_every=12",
    "budget.plateau.epochs=1", "budget.plateau.patience=50", "budget.plateau.gain=0", "budget.plateau.after=0",
)  # fmt: skip
LEAN = (  # every rule of the lean budget: points are left out, images are small at first; it settles before the end
    "budget=lean", "budget.density.start=10", "budget.density.every=10", "budget.pixels.smallest_side=8",
    "budget.points.most=1", "budget.settling.fewest=1", "budget.settling.every=5", "budget.settling.gain=50",
    "budget.settling.checks=4", "budget.settling.slope_checks=3", "budget.settling.since=0",
    "budget.settling.full_after=0", "budget.settling.most_growth=50", "budget.settling.tail=0.3",
)  # fmt: skip
SETTLED = 30  # the iteration; the tail has 9 more


def set_up(scene, name: str, *overrides: str) -> Trainer:
    """A trainer of a method, or of 3DGS with the lean budget (`lean`)."""
    if name == "lean":
        return ready_to_train(scene, "3dgs", ITERATIONS, *LEAN, f"budget.iterations={ITERATIONS}")
    return ready_to_train(scene, name, ITERATIONS, *OFTEN, *overrides)


def timeless(log: TrainingLog):
    return log.iterations, [(n.iteration, n.loss, n.psnr, n.gaussians, n.terms) for n in log.lines]


@pytest.mark.parametrize("name", ["3dgs", "lean"])
def test_a_killed_training_ends_with_the_same_bytes(small_gray_scene, tmp_path, name):
    trainer = set_up(small_gray_scene, name)
    calm = train(trainer)
    wanted = digest(trainer)
    if name == "lean":
        model, curriculum = trainer.gaussians["thermal"], trainer.context.curricula["thermal"]
        assert curriculum.settled_at == SETTLED and calm.iterations == 39 and model.work.points_left_out > 0
    stops = [1, 9, 10, 26, SETTLED - 1, SETTLED, SETTLED + 6]
    trainer, log = train_killed(lambda: set_up(small_gray_scene, name), tmp_path / "a.pt", stops)
    assert log.resumed == stops
    assert timeless(log) == timeless(calm)
    assert digest(trainer) == wanted
    # once it has ended, nothing is left to do
    trainer = set_up(small_gray_scene, name)
    ended = Checkpoint(tmp_path / "a.pt", {"key": "k"}, 0.0).resume(trainer)
    assert timeless(train(trainer, log=ended)) == timeless(calm)
    assert digest(trainer) == wanted


class TwoStages(Method):
    """One model that two stages train."""

    def stages(self):
        return [Stage("first", self._set_up, self._step, 0.5), Stage("second", self._again, self._step, 0.5)]

    def _set_up(self, context):
        self.model, self.views = context.gaussians(), context.views()

    def _again(self, context):
        context.add_part("thermal", self.model)
        self.views = context.views()

    def _step(self, iteration):
        view = self.views.next()
        render = self.model.render(view.camera)
        target, valid = THERMAL.tensors_of(view, render.image.device)
        loss = photometric(render.image, target, 0.2, valid)
        return Step(loss, {"thermal": loss}, render, target, valid)


def test_a_model_that_a_second_stage_trains_grows_again(small_gray_scene, tmp_path):
    def ready():
        return ready_to_train(small_gray_scene, "3dgs", 100, *LEAN, "budget.iterations=100", method=TwoStages())

    whole, seen = ready(), []
    train(whole, after_iteration=lambda log: seen.append((whole.stage_number, log.iterations, model_stop(whole))))
    second = [(iteration, stop) for stage, iteration, stop in seen if stage == 1]
    (begun, first_stop), ended_at = second[0], max(stop for _, stop in second)
    assert first_stop == ended_at > min(stop for stage, _, stop in seen if stage == 0)  # not that of the first stage
    resumed, _ = train_killed(ready, tmp_path / "a.pt", [begun + 3])
    assert digest(resumed) == digest(whole)


def model_stop(trainer: Trainer) -> int:
    """The iteration at which density control of the one model stops."""
    return trainer.method.model.density.rules.stop


def test_an_ended_plateau_stays_ended(small_gray_scene, tmp_path):
    soon = (
        "budget.plateau.patience=1", "budget.plateau.gain=0.9", "budget.plateau.after=10",
        "budget.density.start=100", "budget.density.opacity_reset_every=100",
    )  # fmt: skip
    for _ in range(2):
        trainer, checkpoint = set_up(small_gray_scene, "3dgs", *soon), Checkpoint(tmp_path / "a.pt", {}, 0.0)
        log = checkpoint.resume(trainer)
        checkpoint._next = 0.0
        log = train(trainer, after_iteration=checkpoint.write_if_due, log=log)
        assert log.iterations == 4 * len(small_gray_scene.train)  # two windows, from the first round after 10


def test_what_was_made_otherwise_is_not_used(small_gray_scene, tmp_path):
    def resumed_with(made_with):
        trainer = set_up(small_gray_scene, "3dgs", "budget.iterations=5")
        checkpoint = Checkpoint(tmp_path / "a.pt", made_with, 0.0)
        return checkpoint, checkpoint.resume(trainer), trainer

    checkpoint, log, trainer = resumed_with({"key": "k", "cpu": "A"})
    train(trainer, after_iteration=checkpoint.write_if_due, log=log)
    checkpoint, log, _ = resumed_with({"key": "k", "cpu": "B"})
    assert log.iterations == 0 and "not used: other cpu" in checkpoint.notes[0]
    checkpoint.path.write_bytes(b"no such thing")
    checkpoint, log, _ = resumed_with({"key": "k", "cpu": "A"})
    assert log.iterations == 0 and "a checkpoint was not used" in checkpoint.notes[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_is_told_and_training_goes_on(small_gray_scene, tmp_path, monkeypatch):
    trainer = set_up(small_gray_scene, "3dgs", "budget.iterations=2")
    checkpoint = Checkpoint(tmp_path / "a.pt", {}, 0.0)
    log = checkpoint.resume(trainer)

    save = torch.save
    monkeypatch.setattr(torch, "save", lambda content, _: save(content, "/dev/full"))
    assert train(trainer, after_iteration=checkpoint.write_if_due, log=log).iterations == 2
    assert checkpoint.notes[0].startswith(f"no checkpoint at iteration 1 in {tmp_path}: ")
    assert not list(tmp_path.iterdir())


def test_what_a_killed_writer_left_goes(small_gray_scene, tmp_path):
    (tmp_path / ".a.123.pt").write_bytes(b"half")
    Checkpoint(tmp_path / "a.pt", {}, None).resume(set_up(small_gray_scene, "3dgs"))
    assert not list(tmp_path.iterdir())


def test_seconds_below_zero_are_refused(tmp_path):
    with pytest.raises(ValueError, match="checkpoint is -1"):
        Checkpoint(tmp_path / "a.pt", {}, -1)


@pytest.fixture(scope="module")
def stored_once(small_gray_scene, tmp_path_factory):
    """Store a checkpoint of MSMG after 12 iterations; return its path, and a trainer to resume it with."""
    path = tmp_path_factory.mktemp("stored") / "a.pt"
    trainer, checkpoint = set_up(small_gray_scene, "msmg"), Checkpoint(path, {"key": "k"}, 0.0)
    checkpoint.resume(trainer)

    def killed(log):
        checkpoint.write_if_due(log)
        if log.iterations == 12:
            raise KilledError

    with pytest.raises(KilledError):
        train(trainer, after_iteration=killed)
    return path, set_up(small_gray_scene, "msmg")


@pytest.fixture
def stored(stored_once):
    """Return a function that resumes the checkpoint, which is not used, and returns the notes; `path` is its file."""
    path, trainer = stored_once
    fresh, whole = digest(trainer), path.read_bytes()

    def resume() -> list[str]:
        checkpoint = Checkpoint(path, {"key": "k"}, 0.0)
        assert checkpoint.resume(trainer).iterations == 0
        assert digest(trainer) == fresh  # the training starts afresh
        return checkpoint.notes

    resume.path = path
    yield resume
    path.rmdir() if path.is_dir() else path.unlink()
    path.write_bytes(whole)


def test_a_flipped_bit_anywhere_is_found(stored):
    whole = stored.path.read_bytes()
    rng = random.Random(14)
    for place in [0, len(whole) - 1, *(rng.randrange(len(whole)) for _ in range(100))]:
        stored.path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << rng.randrange(8))]) + whole[place + 1 :])
        assert stored() == ["a checkpoint was not used: it is damaged"]


@pytest.mark.parametrize("size", [0, 1, 31, 32, 33, 5000, -1])
def test_a_truncated_checkpoint_is_not_used(stored, size):
    stored.path.write_bytes(stored.path.read_bytes()[:size])
    assert stored() == ["a checkpoint was not used: it is damaged"]


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path)])
def test_what_is_no_file_is_not_used(stored, make):
    stored.path.unlink()
    make(stored.path)
    assert stored()[0].startswith("a checkpoint was not used: ")


def change(path, at, edit):
    """Edit a stored value and write the file with a correct digest."""
    content = torch.load(path, weights_only=True)
    place = content
    *way, last = at.split(".")
    for name in way:
        place = place[int(name) if isinstance(place, list) else name]
    last = int(last) if isinstance(place, list) else last
    value = edit(place[last])
    if value is None:
        del place[last]
    else:
        place[last] = value
    buffer = io.BytesIO()
    torch.save(content, buffer)
    path.write_bytes(buffer.getvalue() + hashlib.sha256(buffer.getvalue()).digest())


OTHERS = {
    "no parts": ("parts", lambda _: None),
    "a part less": ("parts.rgb", lambda _: None),
    "fewer rows": ("parts.rgb.rows._first", lambda rows: rows[1:].clone()),
    "no rows": ("parts.rgb.rows", lambda rows: {k: v if isinstance(v, int) else v[:0] for k, v in rows.items()}),
    "a list": ("parts.rgb.rows._values", lambda rows: rows.tolist()),
    "no stream": ("parts.rgb_views.generator", lambda _: None),
    "a broken stream": ("parts.thermal_views.generator", lambda state: torch.full_like(state, 255)),
    "a later stage": ("stage", lambda _: 1),
    "an earlier stage": ("stage", lambda _: -1),
    "a stage in words": ("stage", lambda _: "first"),
    "no iterations": ("log.iterations", lambda _: None),
    "lines": ("log.lines.0", lambda line: {**line, "colour": "red"}),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_a_state_that_cannot_be_loaded_is_not_used(stored, name):
    change(stored.path, *OTHERS[name])
    notes = stored()
    assert len(notes) == 1 and notes[0].startswith("a checkpoint was not used: ") and "damaged" not in notes[0]
