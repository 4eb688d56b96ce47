import json
from dataclasses import replace

import numpy as np
from PIL import Image

from tests.helpers.command import tdgbench_here
from tests.helpers.layouts import write_rgbt_scenes, write_thermoscenes
from tests.helpers.paths import ROOT


def test_table(tmp_path, small_gray_scene):
    name = "a_scene_whose_name_is_longer_than_what_a_table_of_eighty_columns_would_leave_to_it"
    write_rgbt_scenes(small_gray_scene, tmp_path / "data" / name)
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert run.returncode == 0, run.stderr
    (row,) = [line for line in run.stdout.splitlines() if line.startswith(f"│ {name} │")]  # not cut
    assert [cell.strip() for cell in row.strip("│").split("│")] == [
        name, "RGBT-Scenes", "10", "8 + 2", "48×36", "1", "n/a", "0.0 %", "n/a", "ok",
    ]  # fmt: skip
    assert "1 of 1 scenes can be used" in run.stdout
    assert f"checking {name}" in run.stderr


def test_the_range_has_a_unit(tmp_path, small_gray_scene):
    """Of images of temperatures, and of raw counts, which have none."""
    write_thermoscenes(small_gray_scene, tmp_path / "data" / "warm", names_thermal=False)
    folder = write_thermoscenes(small_gray_scene, tmp_path / "data" / "raw", names_thermal=False)
    (folder / "temperature_bounds.json").unlink()
    for path in (folder / "thermal").iterdir():
        levels = np.asarray(Image.open(path)).astype(np.uint16)
        levels[:2], levels[-2:] = 0, 255  # the ends of the range, in every view
        Image.fromarray(5500 + levels).save(path)
    out = tdgbench_here(tmp_path, "data", "check", "data").stdout
    assert "│ counts 5500 to 5755 │" in out and "│ 14.0 to 50.0 °C " in out
    content = json.loads(tdgbench_here(tmp_path, "data", "check", "data", "--json").stdout)
    raw, warm = content["scenes"]
    assert (raw["counts"], raw["temperature_degC"]) == ([5500, 5755], None)
    assert (warm["counts"], warm["temperature_degC"]) == (None, [14.0, 50.0])


def test_missing_and_broken_scenes_are_status_1(tmp_path, small_gray_scene):
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert (run.returncode, run.stdout, run.stderr) == (1, "", "data does not exist\n")
    (tmp_path / "data").mkdir()
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert run.returncode == 1 and run.stdout.count("missing ") == 2 * 14 and "0 of 14 scenes can be used" in run.stdout
    folder = write_rgbt_scenes(small_gray_scene, tmp_path / "data" / "a[bold]b")
    (folder / "temperature.json").write_text("{}", encoding="utf-8")
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert run.returncode == 1 and "Traceback" not in run.stderr
    assert "broken a[bold]b: " in run.stdout and "temperature.json must hold" in run.stdout


def test_doubts_and_assumptions_are_shown_and_are_status_1(tmp_path, small_gray_scene):
    (view,) = [view for view in small_gray_scene.train if view.name == "view003"]
    pose = view.camera.world_to_camera + 2000 * np.eye(4, k=3)
    others = [other for other in small_gray_scene.train if other is not view]
    far = replace(view, camera=replace(view.camera, world_to_camera=pose))
    write_rgbt_scenes(replace(small_gray_scene, train=[far, *others]), tmp_path / "data" / "a")
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert run.returncode == 1 and "1 of 1 scenes can be used, 1 of them with doubts" in run.stdout
    assert "doubtful a: view view003: the camera stands " in run.stdout and " doubtful │" in run.stdout
    assert "note a: assumed size: 48×36 px" in run.stdout
    content = json.loads(tdgbench_here(tmp_path, "data", "check", "data", "--json").stdout)
    (scene,) = content["scenes"]
    assert content["usable"] and scene["status"] == "doubtful" and not scene["problems"]
    assert len(scene["doubts"]) == 1 and scene["assumed"]["size"].startswith("48×36 px")


def test_a_capture_without_a_layout_is_told_the_layouts_and_not_the_papers_scenes(tmp_path):
    (tmp_path / "data" / "roof" / "rgb").mkdir(parents=True)
    run = tdgbench_here(tmp_path, "data", "check", "data")
    assert run.returncode == 1 and "no scene in data" in run.stderr and "RGBT-Scenes: " in run.stderr
    assert "Dimsum" not in run.stdout + run.stderr


def test_json_has_the_documented_keys(tmp_path, small_gray_scene, monkeypatch):
    monkeypatch.setattr("tdgbench.terminal.LONGEST", 1000)  # it is not cut as messages are
    write_rgbt_scenes(small_gray_scene, tmp_path / "data" / "RGBT-Scenes" / "Truck")
    run = tdgbench_here(tmp_path, "data", "check", "data", "--json")
    content = json.loads(run.stdout)
    assert run.returncode == 1 and content["format"] == 4 and content["scenes_of"] == "paper" and not content["usable"]
    truck = next(scene for scene in content["scenes"] if scene["name"] == "Truck")
    assert (truck["status"], truck["views"], truck["sizes_px"]) == ("ok", 10, [[48, 36]])
    page = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")
    for key in (*content, *truck):
        assert f"`{key}`" in page, f"docs/data.md does not describe {key}"
