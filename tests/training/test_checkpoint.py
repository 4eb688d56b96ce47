import hashlib
from pathlib import Path

import pytest
import torch

from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.skips.plateau import Plateau, PlateauRule
from tests.helpers.training import ready_to_train

ITERATIONS = 60
RULE = PlateauRule(rounds=1, patience=50, gain=0.0, after=0)


class KilledError(Exception):
    pass


def set_up(scene, name: str):
    """A method that is ready to train, its context and a plateau that is watched but never reached."""
    often = (
        "budget.density.start=10", "budget.density.every=10", "budget.density.opacity_reset_every=25",
        "budget.density.reset_recovery=1",
        "budget.sh_every=12",
    )  # fmt: skip
    method, context = ready_to_train(scene, name, ITERATIONS, *often)
    return method, context, Plateau(RULE, len(scene.train))


def digest(method) -> str:
    """Of everything that training changes."""
    content = hashlib.sha256()
    for model in method.models().values():
        _ = model.gaussians  # brings every row up to date
        for tensor in (model.state.values, model.state.first, model.state.second, model.density.grad_sum):
            content.update(tensor.numpy().tobytes())
        content.update(repr((model.degree, model.work, model.optimizer.steps)).encode())
    return content.hexdigest()


def timeless(log: TrainingLog):
    return log.iterations, [(n.iteration, n.loss, n.psnr, n.gaussians, n.terms) for n in log.lines]


@pytest.mark.parametrize("name", ["tdg", "msmg", "splat"])
def test_a_killed_training_ends_with_the_same_bytes(small_gray_scene, tmp_path, name):
    method, _, plateau = set_up(small_gray_scene, name)
    calm = train(method, ITERATIONS, plateau=plateau)
    wanted = digest(method)
    log = TrainingLog()
    stops = [1, 9, 10, 26, 47, ITERATIONS]
    for stop in stops:
        method, context, plateau = set_up(small_gray_scene, name)
        checkpoint = Checkpoint(tmp_path / "a.pt", {"key": "k"}, 0.0)
        log = checkpoint.take_up(method, context, plateau)
        checkpoint._next = 0.0  # every step, however long writing takes

        def killed(log, checkpoint=checkpoint, stop=stop):
            checkpoint.after_step(log)
            checkpoint._next = 0.0
            if log.iterations == stop < ITERATIONS:
                raise KilledError

        if stop < ITERATIONS:
            with pytest.raises(KilledError):
                train(method, ITERATIONS, plateau=plateau, on_step=killed, log=log)
        else:
            log = train(method, ITERATIONS, plateau=plateau, on_step=killed, log=log)
    assert log.resumed == stops[:-1]
    assert timeless(log) == timeless(calm)
    assert digest(method) == wanted
    # once it has ended, nothing is left to do
    method, context, plateau = set_up(small_gray_scene, name)
    ended = Checkpoint(tmp_path / "a.pt", {"key": "k"}, 0.0).take_up(method, context, plateau)
    assert timeless(train(method, ITERATIONS, plateau=plateau, log=ended)) == timeless(calm)
    assert digest(method) == wanted


def test_writing_changes_nothing(small_gray_scene, tmp_path):
    digests = []
    for seconds in (None, 0.0):
        method, context, plateau = set_up(small_gray_scene, "tdg")
        checkpoint = Checkpoint(tmp_path / "a.pt", {}, seconds)
        log = checkpoint.take_up(method, context, plateau)
        train(method, ITERATIONS, plateau=plateau, on_step=checkpoint.after_step, log=log)
        digests.append(digest(method))
        assert checkpoint.path.exists() == (seconds is not None)
    assert digests[0] == digests[1]


def test_an_ended_plateau_stays_ended(small_gray_scene, tmp_path):
    rule = PlateauRule(rounds=1, patience=1, gain=0.9, after=10)
    for _ in range(2):
        method, context, _ = set_up(small_gray_scene, "splat")
        plateau, checkpoint = Plateau(rule, 5), Checkpoint(tmp_path / "a.pt", {}, 0.0)
        log = checkpoint.take_up(method, context, plateau)
        checkpoint._next = 0.0
        log = train(method, ITERATIONS, plateau=plateau, on_step=checkpoint.after_step, log=log)
        assert log.iterations == 20


def test_what_was_made_otherwise_is_not_used(small_gray_scene, tmp_path):
    def taken_up(made_with):
        method, context, plateau = set_up(small_gray_scene, "splat")
        checkpoint = Checkpoint(tmp_path / "a.pt", made_with, 0.0)
        return checkpoint, checkpoint.take_up(method, context, plateau), method

    checkpoint, log, method = taken_up({"key": "k", "cpu": "A"})
    train(method, 5, on_step=checkpoint.after_step, log=log)
    checkpoint, log, _ = taken_up({"key": "k", "cpu": "B"})
    assert log.iterations == 0 and "not used: other cpu" in checkpoint.notes[0]
    checkpoint.path.write_bytes(b"no such thing")
    checkpoint, log, _ = taken_up({"key": "k", "cpu": "A"})
    assert log.iterations == 0 and "a checkpoint was not used" in checkpoint.notes[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_is_told_and_training_goes_on(small_gray_scene, tmp_path, monkeypatch):
    method, context, plateau = set_up(small_gray_scene, "splat")
    checkpoint = Checkpoint(tmp_path / "a.pt", {}, 0.0)
    log = checkpoint.take_up(method, context, plateau)

    save = torch.save
    monkeypatch.setattr(torch, "save", lambda content, _: save(content, "/dev/full"))
    assert train(method, 2, on_step=checkpoint.after_step, log=log).iterations == 2
    assert checkpoint.notes[0].startswith(f"no checkpoint at iteration 1 in {tmp_path}: ")
    assert not list(tmp_path.iterdir())


def test_what_a_killed_writer_left_goes(small_gray_scene, tmp_path):
    (tmp_path / ".a.123.pt").write_bytes(b"half")
    Checkpoint(tmp_path / "a.pt", {}, None).take_up(*set_up(small_gray_scene, "splat"))
    assert not list(tmp_path.iterdir())


def test_seconds_below_zero_are_refused(tmp_path):
    with pytest.raises(ValueError, match="checkpoint is -1"):
        Checkpoint(tmp_path / "a.pt", {}, -1)
