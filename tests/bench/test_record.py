import json
from dataclasses import fields

import pytest

from tdgbench.bench.record import FILE, Failure, SkipRecord, read_all, read_record, schema_problems
from tdgbench.training.skips import Skip
from tests.helpers.records import record


def test_round_trip(tmp_path):
    written = record(scores={"psnr": 20.0, "lpips": None}, failure=Failure("train", "boom", "…", 7, "loss"))
    written.write(tmp_path)
    assert read_record(tmp_path) == written and [p.name for p in tmp_path.iterdir()] == [FILE]


def test_titles():
    assert record().title == "tdg on synthetic/orbit, colmap, seed 0"
    assert record(variant="a=1").title.endswith("[a=1]")


def test_nan_is_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        record(scores={"psnr": float("nan")}).write(tmp_path)
    assert not list(tmp_path.iterdir())


def test_reading_all_skips_hidden_folders(tmp_path):
    for name in ("a", ".b"):
        folder = tmp_path / "cells" / name
        folder.mkdir(parents=True)
        record().write(folder)
    assert len(read_all(tmp_path)) == 1 and read_all(tmp_path / "nothing") == []


@pytest.mark.parametrize("content", ["", "[]", "{}", json.dumps({"schema": 99, "failure": None})])
def test_broken_records_are_named(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ValueError, match=r"record\.json is not a record"):
        read_record(tmp_path)


def test_a_skip_in_a_record_has_the_fields_of_a_skip():
    assert set(SkipRecord.__annotations__) == {f.name for f in fields(Skip)}


def test_the_schema_is_that_of_the_dataclass(small_results):
    text = next((small_results / "cells").rglob(FILE)).read_text()
    assert schema_problems(text) == []
    content = json.loads(text)
    del content["density"]  # older records lack it
    assert schema_problems(json.dumps(content)) == []
    assert schema_problems("[]") == ["$: Input should be an object"]
