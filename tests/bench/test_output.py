import pytest

from tdgbench.bench.output import hashes, whole_folder


def test_takes_its_place_whole(tmp_path):
    target = tmp_path / "cells" / "seed0"
    with whole_folder(target) as part:
        (part / "model.ply").write_text("one")
        assert not target.exists()
    with whole_folder(target) as part:
        (part / "model.ply").write_text("two")
        assert (target / "model.ply").read_text() == "one"
    assert (target / "model.ply").read_text() == "two" and len(list(target.parent.iterdir())) == 1


def test_an_error_leaves_what_was_there(tmp_path):
    target = tmp_path / "seed0"
    with whole_folder(target) as part:
        (part / "a.png").write_text("one")
    with pytest.raises(RuntimeError), whole_folder(target) as part:
        (part / "a.png").write_text("two")
        raise RuntimeError
    assert (target / "a.png").read_text() == "one" and list(tmp_path.iterdir()) == [target]


def test_hashes_of_pictures_and_models(tmp_path):
    (tmp_path / "renders").mkdir()
    (tmp_path / "renders" / "v.png").write_bytes(b"")
    (tmp_path / "log.csv").write_text("x")
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert hashes(tmp_path) == {"renders/v.png": empty}
