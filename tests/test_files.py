import pytest

from tdgbench.files import whole_file, write_text


def test_whole_or_not_at_all(tmp_path):
    write_text(tmp_path / "a.txt", "°C")
    with pytest.raises(RuntimeError), whole_file(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise RuntimeError
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "°C"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
