import json
import os

import pytest

from tdgbench.bench.backend_check import stored
from tdgbench.bench.backend_check.check import Verdict
from tdgbench.bench.backend_check.stored import check_version, place_of, read_verdict, write_verdict

IDENTITY = {"gpu": "A", "driver": "1", "cuda": "12.8", "torch": "2.9", "gsplat": "1.5.3", "check": "c"}
GOOD = Verdict("", 1e-6, 2e-5, 0.0, 3.1)
REFUSED = Verdict("it is wrong", None, 0.5, None, 3.0)


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return place_of(IDENTITY)


@pytest.mark.parametrize("verdict", [GOOD, REFUSED])
def test_a_verdict_is_read_as_it_was_written(path, verdict, tmp_path):
    assert read_verdict(path, IDENTITY) is None
    write_verdict(path, IDENTITY, verdict)
    assert read_verdict(path, IDENTITY) == verdict
    assert path.is_relative_to(tmp_path / "tdgbench") and [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("name", list(IDENTITY))
def test_each_version_has_its_own_verdict(path, name):
    assert place_of({**IDENTITY, name: "another"}) != path
    assert place_of({**IDENTITY, name: None}) != path


def damaged(change):
    content = {"identity": dict(IDENTITY), "verdict": dict(vars(GOOD))}
    change(content)
    return json.dumps(content)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "Invalid JSON"),
        (damaged(lambda c: None)[:-20], "Invalid JSON"),
        ("[]", "should be an object"),
        ("\xff\xfe", "Invalid JSON"),
        (damaged(lambda c: c.pop("verdict")), "verdict"),
        (damaged(lambda c: c["verdict"].update(image="small")), "verdict.image"),
        (damaged(lambda c: c["verdict"].update(image=float("nan"))), "verdict.image"),
        (damaged(lambda c: c["verdict"].update(image=-1.0)), "verdict.image"),
        (damaged(lambda c: c["verdict"].update(image=None)), "errors that were measured"),
        (damaged(lambda c: c["verdict"].update(run="rm")), "verdict.run"),
        (damaged(lambda c: c["identity"].update(driver="2")), "another GPU or on other versions"),
    ],
)
def test_a_damaged_or_foreign_file_is_no_verdict(path, text, problem):
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=problem):
        read_verdict(path, IDENTITY)


def test_only_regular_files_are_read(path):
    path.parent.mkdir(parents=True)
    os.mkfifo(path)
    with pytest.raises(ValueError, match="not a regular file"):
        read_verdict(path, IDENTITY)
    path.unlink()
    path.symlink_to("nowhere")
    with pytest.raises(ValueError, match="link to nothing"):
        read_verdict(path, IDENTITY)


def test_another_check_has_another_version(monkeypatch, tmp_path):
    before = check_version()
    assert len(before) == 16
    source = tmp_path / "reference.py"
    source.write_text("A = 1")
    monkeypatch.setattr(stored, "fingerprinted_files", lambda: [source])
    try:
        check_version.cache_clear()
        assert check_version() != before
    finally:
        check_version.cache_clear()
