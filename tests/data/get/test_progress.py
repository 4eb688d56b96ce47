import pytest
from rich.console import Console

from tdgbench.data.get import progress
from tdgbench.data.get.progress import Meter, meter


class Clock:
    seconds = 100.0

    def monotonic(self) -> float:
        return self.seconds


@pytest.fixture
def clock(monkeypatch):
    one = Clock()
    monkeypatch.setattr(progress, "time", one)
    return one


def shown(clock, capsys, total, steps) -> list[str]:
    """Lines after each (seconds, done)."""
    with meter("lion.zip", total) as show:
        for seconds, done in steps:
            clock.seconds = 100 + seconds
            show(done)
    return capsys.readouterr().out.splitlines()


def test_lines_at_steps_of_ten_percent(clock, capsys):
    lines = shown(clock, capsys, 1000, [(10 * n, 30 * n) for n in range(34)])
    assert lines[0] == "lion.zip: 12 %, 120 bytes of 1.0 kB, 3 bytes/s" and len(lines) == 8


def test_no_lines_within_five_seconds(clock, capsys):
    assert shown(clock, capsys, 1000, [(0.1 * n, 20 * n) for n in range(51)]) == []


def test_a_slow_download_has_a_line_a_minute(clock, capsys):
    lines = shown(clock, capsys, 10**9, [(n, 1000 * n) for n in range(601)])
    assert len(lines) == 10 and lines[-1] == "lion.zip: 0 %, 600.0 kB of 1.0 GB, 1.0 kB/s"


def test_an_unknown_total(clock, capsys):
    assert shown(clock, capsys, None, [(0, 0), (61, 122)]) == ["lion.zip: 122 bytes of unknown size, 2 bytes/s"]


def test_a_resumed_download_counts_its_speed_from_where_it_began(clock, capsys):
    assert shown(clock, capsys, 1000, [(0, 500), (10, 700)]) == ["lion.zip: 70 %, 700 bytes of 1.0 kB, 20 bytes/s"]


def test_a_bar_on_a_terminal(capsys):
    out = Console(force_terminal=True, width=100, record=True)
    one = Meter("lion.zip \x1b[2J", 1000, "bytes", out)
    one.start()
    one(250)
    one.add(250)
    one.stop()
    text = capsys.readouterr().out
    assert "500 bytes of 1.0 kB" in text and "\x1b[2J" not in text and "\\x1b[2J" in text
