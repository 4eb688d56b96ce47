from dataclasses import replace

import pytest

from tdgbench.data import sample
from tdgbench.scenes import FolderDataset, ReadOptions
from tdgbench.scenes.registry import ORIGIN
from tests.helpers.command import tdgbench_here


def test_a_sample_is_a_scene_that_is_checked_and_read_as_a_folder(tmp_path, monkeypatch):
    write = sample.write_scene
    small = {"width": 48, "height": 36, "points": 300}
    monkeypatch.setattr(sample, "write_scene", lambda world, out, asked: write(world, out, replace(asked, **small)))
    run = tdgbench_here(tmp_path, "data", "sample", "roof", "--scene", "night")
    assert run.returncode == 0 and "roof: night, 40 views in the layout of RGBT-Scenes" in run.stdout
    check = tdgbench_here(tmp_path, "data", "check", "roof")
    assert check.returncode == 0 and "│ roof  │ RGBT-Scenes │ 40 " in check.stdout
    assert ORIGIN in FolderDataset(str(tmp_path), ReadOptions()).load("roof").assumed
    before = (tmp_path / "roof" / "temperature.json").stat().st_mtime_ns
    again = tdgbench_here(tmp_path, "data", "sample", "roof")
    assert again.returncode == 1 and "roof is there already" in again.stderr
    assert (tmp_path / "roof" / "temperature.json").stat().st_mtime_ns == before


@pytest.mark.parametrize("name", [".hidden", "Average"])
def test_names_that_no_scene_can_have(tmp_path, name):
    run = tdgbench_here(tmp_path, "data", "sample", name)
    assert run.returncode == 1 and "rename its folder" in run.stderr and not (tmp_path / name).exists()
