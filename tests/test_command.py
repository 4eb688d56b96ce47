"""The command line itself: help, tools, what a run leaves; what its experiments do is tested in test_main.py."""

from __future__ import annotations

import os
import sys

import pytest

from tdgbench import command
from tdgbench.resources import conf_folder
from tdgbench.terminal import FULL_ERROR
from tdgbench.tools import TOOLS, usage
from tests.helpers.command import tdgbench_here


def test_a_run_leaves_the_environment_as_it_was(monkeypatch):
    """Else whatever this process runs next would print tracebacks."""
    monkeypatch.setattr(sys, "argv", ["tdgbench"])
    monkeypatch.delenv(FULL_ERROR, raising=False)
    before = dict(os.environ)
    with pytest.raises(Exception, match="nosuch"):
        command.run(["nosuch=1"])
    assert os.environ == before


def test_a_traceback_is_printed_if_it_is_wanted(monkeypatch, tmp_path):
    short = tdgbench_here(tmp_path, "nosuch=1")
    monkeypatch.setenv(FULL_ERROR, "1")
    long = tdgbench_here(tmp_path, "nosuch=1")
    assert short.returncode == long.returncode == 1
    assert short.stderr.startswith("error: nosuch=1") and "Traceback" not in short.stderr
    assert long.stderr.startswith("Traceback")


@pytest.mark.parametrize(
    ("words", "hydras"),
    [([], [command.DEMO]), (["scene=orbit"], ["scene=orbit"]), (["name=x", "-m"], ["-m", "name=x"])],
)
def test_what_hydra_gets(monkeypatch, words, hydras):
    """Without words the demo: the first command of the README."""
    got = []
    monkeypatch.setattr(sys, "argv", ["tdgbench"])
    monkeypatch.setattr(command, "run_experiment", lambda: got.extend(sys.argv[1:]))
    assert command.run(words) == 0 and got == hydras


@pytest.mark.parametrize("name", TOOLS)
def test_every_tool_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as stop:
        TOOLS[name].load()(["--help"])
    assert stop.value.code == 0 and capsys.readouterr().out.startswith(f"usage: tdgbench {name} ")


@pytest.mark.parametrize("words", [["tables", "a", "--columns", "psnr", "b"], ["verify", "a", "--data", "c", "b"]])
def test_flags_of_tools_stand_anywhere(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.run(words) == 1
    assert "a is not there" in (said := "".join(capsys.readouterr())) and "b is not there" in said


def test_help_fits_on_a_screen_and_names_everything():
    lines = usage().splitlines()
    assert len(lines) <= 45
    for experiment in (conf_folder() / "experiment").glob("*.yaml"):
        assert any(line.startswith(f"  {experiment.stem} ") for line in lines)
    groups = lines[lines.index("Groups, as GROUP=CHOICE") :]
    for folder in conf_folder().iterdir():
        if folder.is_dir() and folder.name != "experiment":
            row = next(line for line in groups if line.startswith(f"  {folder.name} "))
            assert {path.stem for path in folder.glob("*.yaml")} == set(row.split()[1:])
            lines.remove(row)  # as long as it must be
    assert all(any(f" {tool} " in line for line in lines) for tool in TOOLS)
    assert max(map(len, lines)) <= 120
