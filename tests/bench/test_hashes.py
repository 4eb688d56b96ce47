from tdgbench.bench.hashes import hashes


def test_hashes_of_pictures_and_models(tmp_path):
    (tmp_path / "renders").mkdir()
    (tmp_path / "renders" / "v.png").write_bytes(b"")
    (tmp_path / "log.csv").write_text("x")
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert hashes(tmp_path) == {"renders/v.png": empty}
