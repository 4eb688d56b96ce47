"""Verification passes sound results and finds every kind of tampering."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tdgbench.cells.key import cell_key
from tdgbench.cells.record import read_all, read_record
from tdgbench.verify import main, verify
from tdgbench.verify.record_problems import field_problems
from tests.helpers.cells import small_cells

CELL = Path("cells/tdg/synthetic/turntable/colmap/seed0")


@pytest.fixture
def spoiled(small_results, tmp_path):
    """A copy of results to tamper with, and the folder of its gray cell."""
    copy = shutil.copytree(small_results, tmp_path / "single")
    return copy, copy / CELL


def test_sound_results(small_results, capsys):
    assert verify(small_results)[:-2] == (4, 3, [], 3, (), (), ())
    assert main([str(small_results)]) == 0 and "4 cells, 3 of them finished, 0 problems" in capsys.readouterr().out


def test_gray_scenes_in_three_channels_are_sound(tmp_path, data_root):
    """Their models may be gray throughout; they have temperatures."""
    experiment = small_cells(tmp_path, data_root, ("scene=turntable", "method=3dgs", "skip.gray=false"))
    (record,) = read_all(experiment)
    assert record.channels == 3 and record.temperature_range == [14.0, 50.0]
    assert verify(experiment).problems == []


def test_equal_data_under_two_names_are_said(small_results, tmp_path, capsys):
    copy, named = Path(shutil.copytree(small_results, tmp_path / "twice")), CELL.as_posix().replace("turntable", "mine")
    (copy / named).parent.mkdir(parents=True)
    shutil.copytree(copy / CELL, copy / named)
    record = read_record(copy / named)
    record.scene, record.config["method"]["method"]["_target_"] = "mine", "mine.Mine"
    record.key = cell_key(record)
    record.write(copy / named)
    main([str(copy)])
    said = "data: synthetic/mine has the test images of synthetic/turntable, byte by byte: they are no evidence"
    out = capsys.readouterr().out
    assert said in out and "code: renders of tdg are made again from the stored Gaussians, which takes" in out


SCHEMA_PROBLEMS = [
    ({"seed": "0"}, "$.seed: Input should be a valid integer, not '0'"),
    ({"extra": 1}, "$.extra: Unexpected keyword argument"),
    ({"hashes": {"a": "b"}}, "$.hashes.a: String should match pattern '^[0-9a-f]{64}$', not 'b'"),
    ({"failure": {"phase": "train"}}, "$.failure.error: Field required"),
    ({"status": "fine"}, "$.status: Input should be 'ok' or 'failed', not 'fine'"),
    ({"status": "failed"}, "$: status is failed, but failure is null"),
    ({"iterations": -1}, "$.iterations: Input should be greater than or equal to 0, not -1"),
    ({"channels": 2}, "$.channels: Input should be 0, 1 or 3, not 2"),
    ({"temperature_range": [20.0]}, "$.temperature_range: List should have at least 2 items"),
    ({"parts": {"thermal": {"split": -2}}}, "$.parts.thermal.split: Input should be greater"),
    ({"peak_gpu_mb": float("nan")}, "$.peak_gpu_mb: Input should be a finite number, not nan"),
    ({"skips": [{"name": "gray"}]}, "$.skips.0.allowed: Field required"),
    ({"schema": 1}, "$: its schema is 1, this version reads 2"),
    ({"failure": ...}, "$: lacks failure"),
]


@pytest.mark.parametrize(("change", "problem"), SCHEMA_PROBLEMS, ids=str)
def test_records_that_do_not_fit_the_schema(small_results, change, problem):
    """A field is changed, or left out: `...`."""
    content = json.loads((small_results / CELL / "record.json").read_text()) | change
    text = json.dumps({name: value for name, value in content.items() if value is not ...})
    assert problem in "\n".join(field_problems(text))


def test_problems_of_a_record_are_those_of_its_cell(spoiled, capsys):
    experiment, cell = spoiled
    record = json.loads((cell / "record.json").read_text())
    changes = {"seed": "0", "hashes": {}, "scores": {"psnr": 20.0}}
    (cell / "record.json").write_text(json.dumps({**record, **changes}))
    count, _, problems, *_ = verify(experiment)
    assert count == 4 and all(problem.startswith("tdg/synthetic/turntable/colmap/seed0: ") for problem in problems)
    for part in ("$.seed: Input should be a valid integer", "views.csv is not in the record", "scores lacks ssim"):
        assert part in "\n".join(problems), part
    assert main([str(experiment)]) == 1 and "problem:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("make", "message"),
    [(Path.mkdir, "holds no records"), (Path.touch, "is no folder"), (lambda path: None, "is not there"),
     (lambda path: path.symlink_to(path), "is not there")],
)  # fmt: skip
def test_folders_without_records_are_named_and_the_others_verified(small_results, tmp_path, capsys, make, message):
    folder = tmp_path / "[red]\nx"
    make(folder)
    with pytest.raises(ValueError, match=message):
        verify(folder)
    message = (
        "is no pack, or damaged or changed: it is damaged: File is not a zip file" if folder.is_file() else message
    )
    assert main([str(folder), str(small_results)]) == 1
    out, err = capsys.readouterr()
    assert message in err and r"[red]\nx" in err and err.count("\n") == 1
    assert "4 cells, 3 of them finished, 0 problems" in out


def test_failed_cells_alone_are_no_success(small_results, tmp_path, capsys):
    cells = Path("cells") / "tdg" / "synthetic" / "night"
    shutil.copytree(small_results / cells, tmp_path / cells)
    assert verify(tmp_path)[:3] == (1, 0, [])
    assert main([str(tmp_path)]) == 1 and "1 cell, none of them finished, 0 problems" in capsys.readouterr().out


def test_a_plan_that_cannot_be_read(spoiled):
    experiment, _ = spoiled
    (experiment / "experiment.json").write_text("[]")
    (problem,) = verify(experiment).problems
    assert problem.startswith("its plan cannot be read: ") and "experiment.json is not the plan" in problem


def test_a_lost_record_and_a_moved_cell(spoiled):
    experiment, cell = spoiled
    cell.rename(cell.with_name("seed1"))
    text = "\n".join(verify(experiment).problems)
    assert "seed1: record.json is of another cell: its folder is cells/tdg/synthetic/turntable/colmap/seed0" in text
    (cell.with_name("seed1") / "record.json").unlink()
    assert verify(experiment)[:3] == (3, 2, ["tdg/synthetic/turntable/colmap/seed1: record.json is missing"])


def test_a_broken_cell_hides_no_problem_of_the_others(spoiled, capsys):
    experiment, cell = spoiled
    (cell / "record.json").write_bytes(b"\xff")
    other = experiment / "cells" / "tdg" / "synthetic" / "orbit" / "colmap" / "seed0"
    (other / "log.csv").unlink()
    (experiment / "cells" / "loop").symlink_to(experiment / "cells")
    count, _, problems, *_ = verify(experiment)
    assert count == 4 and len(problems) == 3
    assert [problem.split(":")[0].split("/")[2] for problem in problems] == ["orbit", "orbit", "turntable"]
