from tdgbench.cells.folder import hashes_below, hashes_of_content
from tdgbench.cells.paths import RECORD_FILE

EMPTY = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"


def test_every_file_but_the_record_has_a_hash(tmp_path):
    (tmp_path / "renders").mkdir()
    names = ["cameras.json", "log.csv", "model.ply", "renders/v.png", "views.csv"]
    for name in (*names, RECORD_FILE):
        (tmp_path / name).write_bytes(b"")
    assert hashes_below(tmp_path) == dict.fromkeys(names, EMPTY)


def test_times_are_in_no_hash_that_equal_trainings_share():
    assert hashes_of_content({"log.csv": "a", "views.csv": "b"}) == {"views.csv": "b"}
