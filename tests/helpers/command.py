"""Run `tdgbench`: in a new process, as a user does, or in this one, which saves the seconds of the imports."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess
from unittest import mock

import torch
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton

import tdgbench.command
from tdgbench.__main__ import main
from tdgbench.children import with_path
from tdgbench.splats.cpu import pool
from tests.helpers.paths import ROOT


def command(tmp_path: Path, *arguments: str) -> CompletedProcess[str]:
    """Outcome of a run in a new process, whose results go to `tmp_path`/results."""
    return tdgbench(tmp_path, *arguments, f"results={tmp_path / 'results'}")


def tdgbench(tmp_path: Path, *arguments: str) -> CompletedProcess[str]:
    """Outcome of `python -m tdgbench` in the folder `tmp_path`, in a new process."""
    return subprocess.run(
        [sys.executable, "-m", "tdgbench", *arguments],
        cwd=tmp_path, env={**with_path(ROOT), **_variables(tmp_path)}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip


def command_here(tmp_path: Path, *arguments: str) -> CompletedProcess[str]:
    """`command`, in this process."""
    return tdgbench_here(tmp_path, *arguments, f"results={tmp_path / 'results'}")


def tdgbench_here(tmp_path: Path, *arguments: str) -> CompletedProcess[str]:
    """`tdgbench`, in this process."""
    return program_here(main, tmp_path, "tdgbench", *arguments)


def program_here(program: Callable[[], int | None], folder: Path, *words: str) -> CompletedProcess[str]:
    """Outcome of a program's main function in this process, in `folder`, with `words` as its arguments."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _as_a_process(folder, words):
        try:
            code = program()
        except SystemExit as end:
            code = end.code
        except Exception:  # a process would print it and end
            traceback.print_exc()
            code = 1
    if isinstance(code, str):
        print(code, file=err)
    status = code if isinstance(code, int) else int(code is not None)
    return CompletedProcess(words, status, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _as_a_process(folder: Path, words: tuple[str, ...]) -> Iterator[None]:
    """Working folder, arguments and environment of a process; what a process loses at its end is restored."""
    hydra, root, threads = Singleton.get_state(), logging.getLogger(), torch.get_num_threads()
    handlers, level = root.handlers[:], root.level
    try:
        with (
            contextlib.chdir(folder),
            mock.patch.object(sys, "argv", list(words)),
            mock.patch.object(sys, "path", sys.path[:]),
            mock.patch.dict(os.environ, _variables(folder)),
        ):
            GlobalHydra.instance().clear()
            yield
    finally:
        pool.set_threads(None)
        torch.set_num_threads(threads)
        Singleton.set_state(hydra)
        GlobalHydra.instance().clear()
        root.handlers[:], root.level = handlers, level


def _variables(folder: Path) -> dict[str, str]:
    """CUDA_VISIBLE_DEVICES: tests compare bytes, which a GPU need not repeat."""
    return {"TORCH_HOME": str(folder / "torch"), "COLUMNS": "200", "CUDA_VISIBLE_DEVICES": ""}
