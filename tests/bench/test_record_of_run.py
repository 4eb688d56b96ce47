"""What a record states of its scene's files."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tdgbench.bench.record_of_run import GRAY, state_assumptions, state_values
from tdgbench.cells.record import PALETTE, read_all, read_record, schema_problems
from tdgbench.scenes.scene import PALETTE as OF_SCENES
from tdgbench.text import absolute_paths
from tests.helpers.records import record


def test_a_record_holds_what_a_scene_states_in_bounded_lines_without_its_folder(small_scene, tmp_path):
    folder = Path("/home/ada/orbit")
    scene = replace(
        small_scene, folder=folder, assumed={"model": f"{folder}/sparse/1, larger\nthan 0", "k" * 99: "x" * 5000},
        doubts=[f"view{n}: {folder} is far" for n in range(70)],
    )  # fmt: skip
    written = record(seconds={"train": 1.0})
    state_assumptions(written, scene)
    assert written.assumed == {"model": r"sparse/1, larger\nthan 0", "k" * 59 + "…": "x" * 999 + "…"}
    assert len(written.doubts) == 64 and written.doubts[62:] == [
        "view62: orbit is far", "7 more: see tdgbench data check"
    ]  # fmt: skip
    written.write(tmp_path)
    assert read_record(tmp_path) == written and absolute_paths((tmp_path / "record.json").read_text()) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"assumed": {str(n): "x" for n in range(33)}}, {"assumed": {"size": "x" * 1001}}, {"assumed": {"": "x"}},
        {"assumed": {"k" * 61: "x"}}, {"assumed": {"size": 3}}, {"assumed": [1]}, {"doubts": ["x"] * 65},
        {"doubts": [""]}, {"doubts": "x"},
    ],
    ids=str,
)  # fmt: skip
def test_a_record_of_a_stranger_states_no_more_than_that(changes):
    content = {**asdict(record(seconds={"train": 1.0})), **changes}
    (problem,) = schema_problems(json.dumps(content))
    assert problem.startswith(f"$.{next(iter(changes))}")
    for name in ("assumed", "doubts"):  # as records of earlier versions
        del content[name]
    assert schema_problems(json.dumps(content)) == []


def test_images_in_a_palette_are_told_from_gray_ones_of_three_channels(small_scene, small_gray_scene):
    for scene, said in ((small_scene, OF_SCENES), (small_gray_scene, GRAY)):
        views = [view.with_thermal(np.broadcast_to(view.thermal, (36, 48, 3))) for view in scene.test]
        of_cell = record(channels=3)
        state_values(of_cell, replace(scene, test=views, channels=3))
        assert of_cell.assumed == {"values": said} and of_cell.in_palette == (scene is small_scene)
    stated = record(channels=3, assumed={"values": "°C"})
    state_values(stated, small_scene)
    assert stated.assumed == {"values": "°C"} and OF_SCENES.startswith(PALETTE)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"channels": 3}, True), ({"channels": 1}, False), ({}, False),
        ({"channels": 3, "config": {"dataset": {"options": {"channels": "auto"}}, "skip": {"gray": True}}}, True),
        ({"channels": 3, "config": {"dataset": {"options": {"channels": 3}}}}, False),  # asked for: unknown
        ({"channels": 3, "config": {"skip": {"gray": False}}}, False),
        ({"channels": 3, "config": {"skip": {"otherwise": False}}}, False),
        ({"channels": 3, "config": {"skip": [1], "dataset": 3}}, True),
        ({"channels": 1, "assumed": {"values": OF_SCENES}}, True),  # data.channels=1 averages colours
        ({"channels": 3, "assumed": {"values": "gray, of unknown °C"}}, False),
        ({"channels": 3, "assumed": {"size": "48×36 px"}}, False),
    ],
    ids=str,
)  # fmt: skip
def test_a_record_tells_whether_its_images_are_in_a_palette(fields, expected):
    assert record(**fields).in_palette is expected


def test_a_cell_states_it(small_results):
    found = {cell.scene: cell.in_palette for cell in read_all(small_results) if cell.failure is None}
    assert found == {"orbit": True, "turntable": False}
