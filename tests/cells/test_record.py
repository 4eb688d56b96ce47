import json
import os
from dataclasses import asdict, fields
from pathlib import Path

import pytest

from tdgbench import __version__
from tdgbench.cells.paths import RECORD_FILE
from tdgbench.cells.record import Failure, SkipRecord, read_all, read_record, schema_problems
from tdgbench.training.skips import Skip
from tests.helpers.records import record


def test_round_trip(tmp_path):
    written = record(
        scores={"psnr": 20.0, "lpips": None}, status="failed", failure=Failure("train", "boom", "…", 7, "loss")
    )
    written.write(tmp_path)
    assert read_record(tmp_path) == written and [p.name for p in tmp_path.iterdir()] == [RECORD_FILE]


RELEASED = sorted((Path(__file__).parent / "records").glob("*/*.json"))  # as each version wrote them


@pytest.mark.parametrize("path", RELEASED, ids=lambda path: f"{path.parent.name} {path.stem}")
def test_records_of_earlier_versions_can_be_read(path, tmp_path):
    (tmp_path / RECORD_FILE).write_bytes(path.read_bytes())
    read = read_record(tmp_path)
    read.write(tmp_path)
    assert read_record(tmp_path) == read and read.status == {"finished": "ok", "failed": "failed"}[path.stem]
    content = json.loads(path.read_text())
    assert {name: value for name, value in asdict(read).items() if name in content} == content


def test_this_version_has_stored_records():
    assert {path.stem for path in RELEASED if path.parent.name == __version__} == {"failed", "finished"}


def test_nan_is_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        record(scores={"psnr": float("nan")}).write(tmp_path)
    assert not list(tmp_path.iterdir())


def test_reading_all_skips_hidden_folders(tmp_path):
    for name in ("a", ".b"):
        folder = tmp_path / "cells" / name
        folder.mkdir(parents=True)
        record(seconds={"train": 1.0}).write(folder)
    assert len(read_all(tmp_path)) == 1 and read_all(tmp_path / "nothing") == []


def text(**changes) -> str:
    return json.dumps({**asdict(record(seconds={"train": 1.0})), **changes})


BROKEN = {
    "nothing": "", "array": "[]", "object": "{}", "another schema": json.dumps({"schema": 99, "failure": None}),
    "cut": text()[:-20], "bytes": b"\xff\xfe", "deep": "[" * 100_000, "deep field": text(config=None)[:-1] + "["
    * 100_000, "number as text": text(scores={"psnr": "20"}), "infinite": text(scores={"psnr": float("inf")}),
    "huge": text(parts={"thermal": {"gaussians": 10**400}}), 
    "huge seed": text(seed=0).replace('"seed": 0', f'"seed": 1{"0" * 5000}'),
    "list of scores": text(scores=[1]),
    "stale failure": text(failure=asdict(Failure("train", "boom", ""))),
    "failed without failure": text(status="failed"),
    "no time": text(seconds={}),
}  # fmt: skip


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN)
def test_broken_records_are_named_and_stand_for_failed_cells(tmp_path, content):
    folder = tmp_path / "cells" / "tdg" / "synthetic" / "orbit" / "colmap" / "seed3,a=1"
    folder.mkdir(parents=True)
    (folder / RECORD_FILE).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=r"record\.json is not a record: .*delete its folder"):
        read_record(folder)
    (stands,) = read_all(tmp_path)
    assert stands.title == "tdg on synthetic/orbit, colmap, seed 3 [a=1]" and stands.status == "failed"
    assert (
        stands.why_failed.startswith("its record cannot be read: ") and str(folder / RECORD_FILE) in stands.why_failed
    )


@pytest.mark.parametrize(
    "make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path)], ids=["folder", "FIFO", "loop"]
)
def test_a_record_that_is_no_file_is_refused_by_its_type(tmp_path, make):
    make(tmp_path / RECORD_FILE)
    with pytest.raises(ValueError, match=r"record\.json is not a record: it (is a|cannot be read)"):
        read_record(tmp_path)


def test_settings_of_any_type_are_looked_up():
    assert record(config={"budget": [1]}).setting("budget.iterations") is None


def test_a_skip_in_a_record_has_the_fields_of_a_skip():
    assert set(SkipRecord.__annotations__) == {f.name for f in fields(Skip)}


def test_the_schema_is_that_of_the_dataclass(small_results):
    text = next((small_results / "cells").rglob(RECORD_FILE)).read_text()
    assert schema_problems(text) == []
    content = json.loads(text)
    del content["thermal_camera"]  # older records lack it
    assert schema_problems(json.dumps(content)) == []
    assert schema_problems(json.dumps({**content, "seed": 10**400}))
    assert schema_problems("[]") == ["$: Input should be an object"]
