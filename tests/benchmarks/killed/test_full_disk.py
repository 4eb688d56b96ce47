"""The injected full disk: which write fails, and what it leaves."""

from __future__ import annotations

import subprocess
import sys

import pytest

from benchmarks.killed.full_disk import FullDisk
from tdgbench.children import with_path
from tests.helpers.paths import ROOT

WRITES = """
import os, sys
from pathlib import Path
from benchmarks.killed.full_disk import FullDisk
folder, disk = Path("full"), FullDisk(int(sys.argv[1]), Path("full"))
disk.install()
try:
    folder.mkdir()
    Path("elsewhere").write_text("not counted")
    (folder / "a").write_text("12345678")
    with (folder / "a").open("r+b") as file:
        os.fsync(file.fileno())
    (folder / "a").replace(folder / "b")
    (folder / "b").read_text()
finally:
    print(disk.count, sorted((p.name, p.stat().st_size) for p in folder.iterdir()) if folder.exists() else None)
"""


@pytest.mark.parametrize(
    ("first", "left"),
    [
        (0, "4 [('b', 8)]"), (1, "1 None"), (2, "2 [('a', 0)]"), (3, "3 [('a', 4)]"), (4, "4 [('a', 8)]"),
        (5, "4 [('b', 8)]"),
    ],
)  # fmt: skip
def test_the_nth_write_fails(tmp_path, first, left):
    run = subprocess.run(
        [sys.executable, "-c", WRITES, str(first)],
        cwd=tmp_path,
        env=with_path(ROOT),
        capture_output=True,
        text=True,
    )
    assert run.stdout.strip() == left
    assert ("No space left on device" in run.stderr) == (0 < first <= 4)


def test_reads_and_other_folders_are_not_counted(tmp_path):
    disk = FullDisk(1, tmp_path / "full")
    assert not disk._fails(tmp_path / "other") and not disk._fails(3) and disk._fails(tmp_path / "full" / "a")
