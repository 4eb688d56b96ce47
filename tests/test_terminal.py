"""Printing never raises and never changes the exit status, whatever the terminal is."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tdgbench.children import with_path
from tdgbench.terminal import GuardedStream, say
from tests.helpers.paths import ROOT

EIGHT_BITS = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
STYLE = re.compile(r"\x1b\[[0-9;]*m")
PROGRAM = r"""
import sys
from tdgbench.terminal import console, guard_streams, say
guard_streams()
for _ in range(int(sys.argv[2])):
    console().print("[red]\u00b0C[/red] \u00d7")
    print("a bare print \u2191")
    say("[bold] \u20ac", "error:")
open(sys.argv[3], "w").write("a file of the run")
sys.exit(int(sys.argv[1]))
"""


def ran(tmp_path: Path, redirection: str, status: int, variables: dict[str, str] | None = None, prints: int = 1):
    """Outcome of a program that prints and ends with a status; `redirection` is the shell's."""
    words = f'"{sys.executable}" -c "$PROGRAM" {status} {prints} {tmp_path / "file.txt"} {redirection}'
    environment = {**with_path(ROOT), "PROGRAM": PROGRAM, **(variables or {})}
    run = subprocess.run(["bash", "-c", words], env=environment, capture_output=True, timeout=60)
    assert (tmp_path / "file.txt").read_text(encoding="utf-8") == "a file of the run"
    return run


@pytest.mark.parametrize(
    ("redirection", "status"),
    [("> /dev/full", 0), ("> /dev/full", 1), (">&-", 1), ("<&- >&- 2>&-", 1), ("> /dev/full 2>&1", 1)],
)
def test_the_status_stands_where_nothing_can_be_printed(tmp_path, redirection, status):
    run = ran(tmp_path, redirection, status)
    assert run.returncode == status and run.stdout == b"", run.stderr
    if "2>" not in redirection:
        note = run.stderr.decode()
        assert note.startswith("note: nothing more is printed to standard output") and note.count("\n") == 1


def test_a_reader_that_stops_changes_no_status(tmp_path):
    run = ran(tmp_path, "| head -1; exit ${PIPESTATUS[0]}", 1, prints=2_000)
    assert run.returncode == 1 and len(run.stdout.splitlines()) == 1
    assert b"Traceback" not in run.stderr


def test_characters_outside_of_the_encoding_are_printed_as_escapes(tmp_path):
    run = ran(tmp_path, "", 1, EIGHT_BITS)
    assert (run.returncode, run.stderr) == (1, b"")
    assert run.stdout.decode() == "\\xb0C \\xd7\na bare print \\u2191\nerror: [bold] \\u20ac\n"


def test_text_is_no_markup_and_cannot_steer_the_terminal(capsys):
    say("[red]a[/blue] \x1b[2J\n é", "error:")
    assert capsys.readouterr().out == "error: [red]a[/blue] \\x1b[2J\n é\n"
    say("a" * 300, stderr=True)
    assert capsys.readouterr().err == "a" * 300 + "\n"


def test_a_stream_that_breaks_later(capsys):
    stream = io.StringIO()
    guarded = GuardedStream("stdout", stream)
    guarded.writelines(["a", "b"])
    assert stream.getvalue() == "ab"
    stream.close()
    assert guarded.write("lost") == 4
    guarded.flush()
    assert capsys.readouterr().err == "note: nothing more is printed to standard output: it is closed\n"


WIDE = """
from rich.table import Table
from tdgbench.terminal import console
table = Table(*(f"column {i}" for i in range(40)))
table.add_row(*("a name with spaces" for _ in range(40)))
console().print(table)
console(stderr=True).print("word " * 40)
print(console().is_interactive, console(stderr=True).is_interactive)
"""


@pytest.mark.parametrize("variables", [{}, {"COLUMNS": "80", "FORCE_COLOR": "1", "TERM": "xterm"}])
def test_nothing_is_cut_or_wrapped_where_there_is_no_terminal(variables):
    environment = {key: value for key, value in with_path(ROOT).items() if key != "COLUMNS"}
    environment |= {"PYTHONIOENCODING": "utf-8", **variables}
    run = subprocess.run([sys.executable, "-c", WIDE], env=environment, capture_output=True, text=True, timeout=60)
    lines = STYLE.sub("", run.stdout).splitlines()
    assert lines[3].count("a name with spaces") == 40 and "column 39" in lines[1] and "…" not in run.stdout
    assert run.stderr == "word " * 40 + "\n" and lines[-1] == "False False"


def test_a_message_of_megabytes_is_cut(capsys):
    say("a" * 3_000_000, "error:")
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("error: aaa") and line.endswith("a… (2,990,000 more characters)")
