"""`tdgbench view --follow` shows what a training has reached, bit by bit, then its result, and what it waits for."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest
import torch

from tdgbench.training.checkpoint import Checkpoint
from tdgbench.view.cells import Follower, open_cell
from tdgbench.view.command import main
from tests.helpers.browser import CHROMIUM, opened
from tests.helpers.cells import PulledPlugError, run_quietly
from tests.helpers.configs import QUICK, config
from tests.helpers.waiting import waited


def interrupted(seconds: float) -> None:
    """Ctrl-C while there is nothing to show."""
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("method", "more"),
    [
        ("msmg", ["budget.background=mean"]),
        ("thermal3dgs", []),
        ("thermonerf", ["budget.field.rays=32", "budget.field.samples=[8,8]", "budget.field.log2_rows=10"]),
        ("sad_gs", ["prior=synthetic"]),
        ("depth_regularised", ["prior=synthetic"]),
        ("3dgs", ["budget=lean", "budget.iterations=12", "budget.settling=null"]),
    ],
)
def test_the_state_is_that_of_the_training(method, more, tmp_path, data_root, monkeypatch):
    """Of Gaussians in two modalities over a background, of a method with networks, and of one without Gaussians."""
    experiment, write_if_due, found = tmp_path / "single", Checkpoint.write_if_due, []

    def write_and_look(self, log):
        self._next = 0.0
        write_if_due(self, log)
        if log.iterations in (5, 9):
            found.append(follower.next(pytest.fail)["single"])
            view, trainer = next(iter(found[-1].train)), self._trainer
            (frame,) = [trainer.context.frame(one) for one in trainer.context.scene.train if one.name == view]
            for modality in trainer.method.modalities:
                shown = found[-1].method.render_from(frame.camera, modality, view)
                assert torch.equal(shown.image, trainer.method.render(frame, modality).image)

    monkeypatch.setattr(Checkpoint, "write_if_due", write_and_look)
    experiment.mkdir()
    follower = Follower(experiment)
    cfg = config(
        *QUICK, f"method={method}", "scene=turntable", f"data.root={data_root}", f"results={tmp_path}", "checkpoint=0",
        *more,
    )  # fmt: skip
    assert run_quietly(cfg).status == "ok"
    assert [cell.state.replace(",", "").split()[:2] for cell in found] == [["iteration", "5"], ["iteration", "9"]]
    assert found[0].record.title.startswith(f"{method} on synthetic/turntable") and found[0].degC is not None
    last = follower.next(pytest.fail)["single"]
    assert last.state.startswith("finished after 12 iterations") and last.models.keys() == found[0].models.keys()
    assert list((experiment / "running").iterdir()) == []


def test_a_stage_of_rgb_images_shows_no_temperatures(tmp_path, data_root, monkeypatch, capsys):
    """Its network renders what it has not learnt yet."""
    experiment, write_if_due, found = tmp_path / "single", Checkpoint.write_if_due, []

    def write_and_look(self, log):
        self._next = 0.0
        write_if_due(self, log)
        if log.iterations == 5:
            with pytest.raises(KeyboardInterrupt):
                follower.next(interrupted)
        elif log.iterations == 10:
            found.append(follower.next(pytest.fail)["single"])

    monkeypatch.setattr(Checkpoint, "write_if_due", write_and_look)
    experiment.mkdir()
    follower = Follower(experiment)
    small = ("budget.field.rays=32", "budget.field.samples=[8,8]", "budget.field.log2_rows=10")
    cfg = config(
        *QUICK, "method=oezer_finetune", "scene=turntable", f"data.root={data_root}", f"results={tmp_path}",
        "checkpoint=0", *small,
    )  # fmt: skip
    assert run_quietly(cfg).status == "ok" and found[0].state.startswith("iteration 10")
    assert "iteration 5, not trained on thermal images yet" in capsys.readouterr().out


def test_a_training_that_cannot_be_announced_goes_on(tmp_path, data_root):
    (tmp_path / "single").mkdir()
    (tmp_path / "single" / "running").write_text("in the way")
    cfg = config(*QUICK, "method=3dgs", "scene=turntable", f"data.root={data_root}", f"results={tmp_path}")
    outcome = run_quietly(cfg)
    assert outcome.status == "ok" and "tdgbench view --follow cannot show it: " in outcome.message


@pytest.mark.parametrize("kind", ["fifo", "link", "bytes"])
def test_a_checkpoint_that_is_none_is_waited_for(tdg_folder, tmp_path, capsys, kind):
    """As in results of others: nothing hangs, nothing elsewhere is read."""
    experiment = tmp_path / "theirs"
    running, path = experiment / "running" / "a", experiment / "checkpoints" / "a.pt"
    running.mkdir(parents=True)
    path.parent.mkdir()
    for name in ("record.json", "cameras.json"):
        (running / name).write_bytes((tdg_folder / name).read_bytes())
    secret = tmp_path / "secret.pt"
    torch.save({"stage": 0}, secret)
    make = {"fifo": os.mkfifo, "link": lambda p: p.symlink_to(secret), "bytes": lambda p: p.write_bytes(b"x" * 99)}
    make[kind](path)
    why = {"fifo": "it is a FIFO", "link": "it leads out of its folder", "bytes": "it is no file of torch.save"}

    with pytest.raises(KeyboardInterrupt):
        Follower(experiment).next(interrupted)
    assert why[kind] in capsys.readouterr().out


def test_a_training_that_ends_before_its_result_is_told(tmp_path, data_root, monkeypatch, capsys):
    experiment, write_if_due, found = tmp_path / "single", Checkpoint.write_if_due, []
    experiment.mkdir()
    follower = Follower(experiment)
    with pytest.raises(KeyboardInterrupt):
        follower.next(interrupted)

    def look_and_die(self, log):
        self._next = 0.0
        write_if_due(self, log)
        if log.iterations == 5:
            found.append(follower.next(pytest.fail)["single"])
            raise PulledPlugError

    monkeypatch.setattr(Checkpoint, "write_if_due", look_and_die)
    cfg = config(*QUICK, "method=3dgs", "scene=turntable", f"data.root={data_root}", f"results={tmp_path}")
    with pytest.raises(PulledPlugError):
        run_quietly(cfg)
    last = follower.next(pytest.fail)["single"]
    assert found[0].state.startswith("iteration 5, 300 Gaussians at ")
    assert last.state == "it has no result, and does not run"
    states = [f"{last.record.title}: {one.state}" for one in (found[0], last)]
    assert capsys.readouterr().out.splitlines() == [f"no cell of {experiment} runs or is finished", *states]


def test_a_cell_without_a_checkpoint_and_a_folder_that_is_none(small_results, tdg_folder, capsys):
    finished = Follower(small_results).next(pytest.fail)["single"]
    assert finished.state.startswith("finished after 30 iterations, ") and finished.method is None
    assert main(["--follow", str(small_results / "nothing")]) == 1
    assert main(["--follow", str(tdg_folder), str(tdg_folder)]) == 1
    err = capsys.readouterr().err.splitlines()
    assert (
        err[0] == f"tdgbench view: {small_results / 'nothing'} is no folder; name that of an experiment, results/<name>"
    )
    assert err[1] == "tdgbench view: --follow takes one folder, not 2"


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_page_shows_newer_states_and_the_next_cell(tdg_folder, colour_folder, tmp_path):
    pytest.importorskip("viser")
    from tdgbench.view.server import Viewer, serving

    cell, other = open_cell(tdg_folder), open_cell(colour_folder)
    with serving("127.0.0.1", None) as server:
        viewer = Viewer(server, {"single": replace(cell, state="iteration 1")}, 640)
        try:
            with opened(f"http://127.0.0.1:{server.get_port()}", tmp_path / "profile") as page:
                text = "document.getElementById('tdgbench-value')?.parentElement.innerText.trim()"
                page.wait_for(f"({text})?.endsWith('iteration 1')", 90)
                pictures = [page.screenshot()]
                viewer.replace({"single": replace(cell, state="iteration 2")})
                page.wait_for(f"({text})?.endsWith('iteration 2')", 60)
                viewer.replace({"single": replace(other, state="iteration 3")})
                page.wait_for(f"{text} === {other.record.title + chr(10) + 'iteration 3'!r}", 60)
                (client,) = server.get_clients().values()
                first = other.test[min(other.test)]
                waited(lambda: abs(client.camera.position - first.center).max() < 0.01, 60, "the camera is there")
                waited(lambda: abs(page.screenshot().astype(int) - pictures[0]).mean() > 5, 60, "its picture is shown")
                assert page.run("document.querySelectorAll('#tdgbench-value').length") == 1
        finally:
            viewer.close()
