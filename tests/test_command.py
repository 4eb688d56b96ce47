"""The command line itself; what its experiments do is tested in test_main.py."""

from __future__ import annotations

import os
import sys

import pytest

from tdgbench import command


def test_a_run_leaves_the_environment_as_it_was(monkeypatch):
    """Else whatever this process runs next would print tracebacks."""
    monkeypatch.setattr(sys, "argv", ["tdgbench"])
    monkeypatch.delenv(command.FULL_ERROR, raising=False)
    before = dict(os.environ)
    with pytest.raises(Exception, match="nosuch"):
        command.run(["nosuch=1"])
    assert os.environ == before
