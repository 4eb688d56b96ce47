"""A bar on a terminal; elsewhere plain lines, one at the start of a cell and at most one a minute."""

from __future__ import annotations

from io import BytesIO, StringIO, TextIOWrapper

import pytest
from rich.console import Console

from tdgbench.bench.progress import CellProgress, Outcome, finished, finished_records
from tdgbench.cells.record import Failure
from tdgbench.training.loop import LogLine
from tdgbench.training.trainer import LastIteration
from tests.helpers.records import record, write
from tests.helpers.waiting import Clock


@pytest.fixture
def clock():
    return Clock(1000.0)


def line(iteration: int) -> LogLine:
    return LogLine(iteration, 1.0, 0.1234, 27.5, 12345, {})


def test_a_bar_shows_loss_psnr_and_count():
    out = StringIO()
    progress = CellProgress(Console(file=out, force_terminal=True, force_interactive=True, width=160), 100)
    progress.begin("tdg on a/b")
    progress.rename("tdg on a/c")
    progress.start(8)
    progress.phase("prior")
    progress.count(3, 9)
    progress.phase("train")
    progress.line(line(50), LastIteration(70, is_limit=True))
    progress.end()
    text = out.getvalue()
    assert "tdg on a/c" in text and "loss 0.1234" in text and "27.5 dB" in text and "12,345 Gaussians" in text
    assert "71%" in text and "at most" in text


@pytest.mark.parametrize("terminal", [False, True])
def test_one_line_at_the_start_then_at_most_one_a_minute(clock, terminal):
    out = StringIO()
    console = Console(file=out, width=40, force_terminal=terminal, force_interactive=terminal, no_color=True)
    progress = CellProgress(console, 1000, clock, cells_at_once=1 + terminal)  # two bars would overwrite one another
    progress.begin("tdg on /c")
    progress.phase("load")
    progress.rename("tdg on a/c")
    assert out.getvalue() == ""  # its result may be there
    progress.start(8)
    progress.phase("train")
    for iteration in range(1, 1001):  # 0.5 s each
        progress.line(line(iteration), LastIteration(1000, is_limit=False))
        clock.seconds += 0.5
    progress.end()
    lines = out.getvalue().splitlines()
    assert lines[0] == "tdg on a/c: starts, 1000 iterations on 8 training views"
    assert lines[1] == (
        "tdg on a/c: iteration 121 of 1000, loss 0.1234, PSNR 27.5 dB, 12,345 Gaussians, about 0:07:20 left"
    )
    assert len(lines) == 1 + 8 and lines[-1].endswith("about 0:00:20 left")
    assert all(text.startswith("tdg on a/c: ") for text in lines)


def test_the_time_left_is_that_at_the_latest_pace_also_after_a_checkpoint(clock):
    out = StringIO()
    progress = CellProgress(Console(file=out), 1000, clock)
    progress.begin("a")
    progress.phase("train")
    for iteration, seconds in ((601, 60), (701, 100), (801, 200)):
        progress.line(line(iteration), LastIteration(1000, is_limit=False))
        clock.seconds += seconds
    progress.line(line(901), LastIteration(1000, is_limit=False))
    assert [text.rpartition("about ")[2] for text in out.getvalue().splitlines()] == [
        "0:02:59 left",  # 299 at 100 in 60 s
        "0:03:19 left",  # 199 at 100 in 100 s
        "0:03:18 left",  # 99 at 100 in 200 s
    ]


def test_a_time_left_is_at_most_that_of_all_iterations_until_a_rule_has_chosen_the_last_one(clock):
    out = StringIO()
    progress = CellProgress(Console(file=out), 15_000, clock)
    progress.begin("a")
    progress.start(8, is_limit=True)
    progress.phase("train")
    for iteration, last in ((1, (15_000, True)), (601, (15_000, True)), (1201, (1320, False))):
        progress.line(line(iteration), LastIteration(*last))
        clock.seconds += 60
    assert [
        text.replace(", loss 0.1234, PSNR 27.5 dB, 12,345 Gaussians", "") for text in out.getvalue().splitlines()
    ] == [
        "a: starts, at most 15000 iterations on 8 training views",
        "a: iteration 601 of at most 15000, at most 0:24:00 left",
        "a: iteration 1201 of 1320, about 0:00:12 left",
    ]


def test_long_stages_before_training_talk_too(clock):
    out = StringIO()
    progress = CellProgress(Console(file=out), 1000, clock)
    progress.begin("tdg on a/c")
    progress.start(80)
    progress.phase("prior")
    for done in (1, 2, 3):
        clock.seconds += 45
        progress.count(done, 80)
    clock.seconds += 70
    progress.phase("init")
    assert out.getvalue().splitlines()[1:] == [
        "tdg on a/c: prior, 2 of 80 views, about 0:58:30 left",
        "tdg on a/c: phase init",
    ]


def test_every_line_is_flushed_and_one_line(clock):
    """A file's buffer holds kilobytes: a reader of a job's log would see nothing for hours."""
    raw = BytesIO()
    stream = TextIOWrapper(raw, encoding="utf-8", write_through=False, line_buffering=False)
    progress = CellProgress(Console(file=stream), 10, clock)
    progress.begin("tdg on a\nb\x1b[2J [red]")
    progress.start(8)
    assert raw.getvalue().decode() == "tdg on a\\nb\\x1b[2J [red]: starts, 10 iterations on 8 training views\n"


def test_a_finished_cell_tells_its_scores():
    done = record(
        scores={"psnr": 24.061, "ssim": 0.8771, "lpips": None}, seconds={"load": 1.5, "compile": 20.0, "train": 60.0}
    )
    outcome = finished(done, "resumed after iteration 9")
    assert outcome.line == (
        "tdg on synthetic/orbit, colmap, seed 0: done, PSNR 24.06 dB, SSIM 0.877, LPIPS n/a, trained in 0:01:00 "
        "(resumed after iteration 9)"
    )
    assert outcome.seconds == 61.5  # kernels are compiled once


def test_finished_cells_are_those_that_were_asked_for_and_have_a_result(tmp_path):
    write(tmp_path, variant="all")
    write(tmp_path, method="3dgs", variant="all")
    write(tmp_path, seed=1, failure=Failure("train", "ValueError: no", ""))
    write(tmp_path, seed=2)
    titles = [f"tdg on RGBT-Scenes/Truck, colmap, seed {seed}" for seed in ("0 [all]", "1", "2")]
    outcomes = [Outcome("kept", titles[0]), Outcome("ok", titles[1]), Outcome("elsewhere", titles[2])]
    found = [(one.method, one.seed) for one in finished_records(tmp_path, outcomes)]
    assert found == [("tdg", 0), ("tdg", 2)]  # another process ran the last one
