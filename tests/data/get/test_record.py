import pytest

from tdgbench.data.get.record import FILE, Content, SceneRecord, read_record
from tdgbench.scenes.errors import SceneError


def record(scene) -> SceneRecord:
    (scene / "é.txt").write_bytes(b"12345")
    content = {"é.txt": Content.of(scene / "é.txt")}
    return SceneRecord("https://zenodo.org", {"lion.zip": "md5:0"}, ["Lion"], content)


def test_a_record_is_read_as_it_was_written(tmp_path):
    assert read_record(tmp_path) is None
    one = record(tmp_path)
    one.write(tmp_path)
    assert read_record(tmp_path) == one and one.damage(tmp_path, lambda size: None) == []


@pytest.mark.parametrize("change", [b"1234", b"123456", b"12346", None])
def test_damage_is_found(tmp_path, change):
    one = record(tmp_path)
    (tmp_path / "é.txt").unlink()
    if change is not None:
        (tmp_path / "é.txt").write_bytes(change)
    sizes = []
    assert one.damage(tmp_path, sizes.append) == ["é.txt"] and sizes == [5]


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"page": 1, "downloads": {}, "scenes": [], "files": {}}'])
def test_a_damaged_record(tmp_path, text):
    (tmp_path / FILE).write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"\.download\.json is damaged; remove it"):
        read_record(tmp_path)
