import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tdgbench.files import file_lock, finish_replacement, whole_file, whole_folder, write_text
from tests.helpers.cells import PulledPlugError
from tests.helpers.paths import ROOT
from tests.helpers.waiting import waited


def test_a_file_is_whole_or_not_at_all(tmp_path):
    write_text(tmp_path / "a.txt", "°C")
    with pytest.raises(RuntimeError), whole_file(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise RuntimeError
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "°C"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_writers_of_one_number_do_not_meet(tmp_path):
    """Processes in two containers may both have the number 1."""
    with whole_file(tmp_path / "a.txt") as one, whole_file(tmp_path / "a.txt") as other:
        one.write_text("one")
        other.write_text("other")
    assert (tmp_path / "a.txt").read_text() == "one" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_takes_its_place_whole(tmp_path):
    target = tmp_path / "cells" / "seed0"
    with whole_folder(target) as part:
        (part / "model.ply").write_text("one")
        assert not target.exists()
    with whole_folder(target) as part:
        (part / "model.ply").write_text("two")
        assert (target / "model.ply").read_text() == "one"
    assert (target / "model.ply").read_text() == "two" and len(list(target.parent.iterdir())) == 1


def test_an_error_keeps_the_old_folder(tmp_path):
    target = tmp_path / "seed0"
    with whole_folder(target) as part:
        (part / "a.png").write_text("one")
    with pytest.raises(RuntimeError), whole_folder(target) as part:
        (part / "a.png").write_text("two")
        raise RuntimeError
    assert (target / "a.png").read_text() == "one" and list(tmp_path.iterdir()) == [target]


def test_leftovers_of_killed_processes_are_removed(tmp_path):
    leftover = tmp_path / ".seed0.part-99999"
    leftover.mkdir()
    (leftover / "half.png").touch()
    with whole_folder(tmp_path / "seed0") as part:
        (part / "a.png").touch()
    assert [p.name for p in tmp_path.iterdir()] == ["seed0"]


def killed_at_rename(number, monkeypatch):
    """Die right before the `number`-th rename; what runs after a kill only here must not matter."""
    replace, calls = Path.replace, []

    def dying(self, target):
        calls.append(target)
        if len(calls) >= number:  # nothing is renamed any more
            raise PulledPlugError
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", dying)
    monkeypatch.setattr("tdgbench.files.shutil.rmtree", lambda *_, **__: None)
    monkeypatch.setattr("tdgbench.files._remove", lambda _: None)


@pytest.mark.parametrize(("number", "content"), [(1, "one"), (2, "two"), (3, "two")])
def test_a_kill_between_renames_loses_nothing(tmp_path, monkeypatch, number, content):
    target = tmp_path / "seed0"
    with whole_folder(target) as part:
        (part / "model.ply").write_text("one")
    with monkeypatch.context() as patch, pytest.raises(PulledPlugError):
        killed_at_rename(number, patch)
        with whole_folder(target) as part:
            (part / "model.ply").write_text("two")
    finish_replacement(target)
    assert (target / "model.ply").read_text() == content
    assert list(tmp_path.iterdir()) == [target]


def test_what_was_replaced_comes_back_where_nothing_else_is(tmp_path):
    old = tmp_path / ".seed0.part-old"
    old.mkdir()
    (old / "model.ply").write_text("one")
    with pytest.raises(RuntimeError), whole_folder(tmp_path / "seed0"):
        raise RuntimeError
    assert (tmp_path / "seed0" / "model.ply").read_text() == "one"


def test_a_folder_that_cannot_be_put_in_place_leaves_the_old_one(tmp_path, monkeypatch):
    target = tmp_path / "seed0"
    with whole_folder(target) as part:
        (part / "model.ply").write_text("one")
    replace = Path.replace

    def full(self, to):
        if self.name.endswith("-new"):
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return replace(self, to)

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
        patch.setattr(Path, "replace", full)
        with whole_folder(target) as part:
            (part / "model.ply").write_text("two")
    assert (target / "model.ply").read_text() == "one"
    finish_replacement(target)  # once there is space
    assert (target / "model.ply").read_text() == "two" and list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("junk", ["file", "link", "fifo"])
def test_what_is_no_folder_is_replaced(tmp_path, junk):
    target, make = (
        tmp_path / "seed0",
        {"file": Path.touch, "link": lambda p: p.symlink_to("nowhere"), "fifo": os.mkfifo},
    )
    make[junk](target)
    with whole_folder(target) as part:
        (part / "a").write_text("one")
    assert (target / "a").read_text() == "one" and list(tmp_path.iterdir()) == [target]


def test_an_error_without_a_name_gets_one(tmp_path):
    with pytest.raises(OSError, match=r"table\.csv"), whole_file(tmp_path / "table.csv"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError, match="seed0"), whole_folder(tmp_path / "seed0"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_other_folders_are_no_leftovers(tmp_path):
    other = tmp_path / ".seed1.part-3"
    other.mkdir()
    with whole_folder(tmp_path / "seed[01]"):
        pass
    assert other.exists()


HOLD = """
import sys, time
from pathlib import Path
from tdgbench.files import file_lock
with file_lock(Path(sys.argv[1])) as acquired:
    print(acquired, flush=True)
    time.sleep(60)
"""


def test_one_at_a_time(tmp_path):
    a, b = tmp_path / "a.lock", tmp_path / "new" / "b.lock"
    with file_lock(a) as first, file_lock(a) as second, file_lock(b) as other:
        assert (first, second, other) == (True, False, True)
    with file_lock(a) as again:
        assert again


def test_a_killed_process_releases_its_lock(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "a")], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline().strip() == "True"
    with file_lock(tmp_path / "a") as acquired:
        assert not acquired
    holder.send_signal(signal.SIGKILL)
    holder.wait()

    def is_free():
        with file_lock(tmp_path / "a") as acquired:
            return acquired

    waited(is_free, 10, "the lock of a killed process is free")
