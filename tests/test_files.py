import os
import stat

import pytest
import torch

from tdgbench.files import whole_file, whole_folder, write_text


def test_a_file_is_whole_or_not_at_all(tmp_path):
    write_text(tmp_path / "a.txt", "°C")
    with pytest.raises(RuntimeError), whole_file(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise RuntimeError
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "°C"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


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


@pytest.mark.parametrize(("umask", "folder", "file"), [(0o022, 0o755, 0o644), (0o027, 0o750, 0o640)])
def test_permissions_follow_the_umask(tmp_path, umask, folder, file):
    before = os.umask(umask)
    try:
        with whole_folder(tmp_path / "seed0") as part:
            (part / "renders").mkdir()
            (part / "renders" / "a.png").touch()
        write_text(tmp_path / "table.csv", "a")
        with whole_file(tmp_path / "checkpoint.pt") as part:
            torch.save({"a": torch.zeros(1)}, part)
    finally:
        os.umask(before)
    modes = {p.relative_to(tmp_path).as_posix(): stat.S_IMODE(p.stat().st_mode) for p in tmp_path.rglob("*")}
    assert modes == {
        "seed0": folder, "seed0/renders": folder, "seed0/renders/a.png": file, "table.csv": file,
        "checkpoint.pt": file,
    }  # fmt: skip
