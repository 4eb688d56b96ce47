import os
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from plyfile import PlyData

from tdgbench.splats import ply
from tdgbench.splats.ply import load_ply, save_ply
from tests.helpers.gaussians import model
from tests.helpers.memory import peak_mb


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_round_trip(tmp_path, channels, degree):
    saved = model(channels, degree)
    save_ply(saved, tmp_path / "model.ply")
    loaded = load_ply(tmp_path / "model.ply")
    assert loaded.channels == channels and loaded.sh_degree == degree
    for name, tensor in saved.items():
        assert torch.equal(tensor, getattr(loaded, name)), name
    assert [p.name for p in tmp_path.iterdir()] == ["model.ply"]


def test_a_model_is_written_piece_by_piece(tmp_path, monkeypatch):
    save_ply(model(3, 2, count=10), tmp_path / "whole.ply")
    monkeypatch.setattr(ply, "CHUNK_ROWS", 4)
    save_ply(model(3, 2, count=10), tmp_path / "pieces.ply")
    assert (tmp_path / "pieces.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize("gray", [0, 4, 9, 10])
def test_a_model_is_read_piece_by_piece(tmp_path, monkeypatch, gray):
    """The first rows are gray; only if all are, the model is."""
    given = model(3, 2, count=10)
    given.sh[:gray] = given.sh[:gray, :, :1]
    field = torch.rand(10, 2)
    save_ply(replace(given, extra_fields={"heat": field}), tmp_path / "model.ply")
    monkeypatch.setattr(ply, "CHUNK_ROWS", 4)
    loaded = load_ply(tmp_path / "model.ply")
    assert loaded.channels == (1 if gray == 10 else 3) and torch.equal(loaded.extra_fields["heat"], field)
    for name in loaded.names():
        assert torch.equal(
            getattr(loaded, name), getattr(given, name)[..., : loaded.channels if name == "sh" else None]
        )


@pytest.mark.parametrize("shorter", [False, True])
def test_a_model_that_changes_while_it_is_read(tmp_path, monkeypatch, shorter):
    """One that is replaced is read as it was; one that is cut is named."""
    path, given, finite = tmp_path / "model.ply", model(1, 0, count=10), ply._finite
    save_ply(given, path)

    def change(*args):
        if shorter:
            os.truncate(path, path.stat().st_size // 2)
        else:
            save_ply(model(1, 0, count=3), path)
        return finite(*args)

    monkeypatch.setattr(ply, "CHUNK_ROWS", 4)
    monkeypatch.setattr(ply, "_finite", change)
    if shorter:
        with pytest.raises(ValueError, match=r"model\.ply is not a 3DGS model: it was cut while it was read"):
            load_ply(path)
    else:
        assert torch.equal(load_ply(path).means, given.means)


def test_columns_are_those_of_3dgs(tmp_path):
    saved = model(3, 3)
    save_ply(saved, tmp_path / "model.ply")
    vertex = PlyData.read(tmp_path / "model.ply")["vertex"]
    names = [p.name for p in vertex.properties]
    assert names[:6] == ["x", "y", "z", "nx", "ny", "nz"]
    assert names[6:9] == ["f_dc_0", "f_dc_1", "f_dc_2"] and names[9:54] == [f"f_rest_{i}" for i in range(45)]
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert np.array_equal(vertex["f_rest_15"], saved.sh[:, 1, 1].numpy())  # channel by channel, 15 each


def test_gray_is_three_equal_channels(tmp_path):
    save_ply(model(1, 1), tmp_path / "model.ply")
    vertex = PlyData.read(tmp_path / "model.ply")["vertex"]
    assert np.array_equal(vertex["f_dc_0"], vertex["f_dc_2"]) and np.array_equal(vertex["f_rest_0"], vertex["f_rest_3"])


def test_a_gray_model_has_as_many_channels_as_are_asked_for(tmp_path):
    given = model(1, 1)
    save_ply(given, tmp_path / "model.ply")
    assert torch.equal(load_ply(tmp_path / "model.ply").sh, given.sh)
    assert torch.equal(load_ply(tmp_path / "model.ply", channels=3).sh, given.sh.repeat(1, 1, 3))


def test_empty_model(tmp_path):
    save_ply(model(3, 1, count=0), tmp_path / "model.ply")
    assert len(load_ply(tmp_path / "model.ply")) == 0


def test_what_is_no_model_is_named(tmp_path):
    (tmp_path / "x.ply").write_text("hello")
    with pytest.raises(ValueError, match=r"x\.ply is not a 3DGS model"):
        load_ply(tmp_path / "x.ply")


def changed(before: bytes, after: bytes, *more: tuple[bytes, bytes]):
    def change(content: bytes) -> bytes:
        for old, new in ((before, after), *more):
            content = content.replace(old, new)
        return content

    return change


TEXT = (b"binary_little_endian", b"ascii")
SPOILED = {
    "cut": (lambda c: c[:-1], "early end-of-file"),
    "longer": (lambda c: c + b"x", "goes on behind the rows"),
    "absurd count": (changed(b"vertex 7", b"vertex 99999999999"), "more than the file has bytes for"),
    "absurd count of text": (changed(b"vertex 7", b"vertex 99999999999", TEXT), "more than the file has bytes"),
    "header only": (lambda c: c[: c.index(b"end_header")], "early end-of-file"),
    "nothing": (lambda c: b"", "does not begin with the line 'ply'"),
    "other bytes": (lambda c: b"ply\n\xff\nend_header\n", "can't decode"),
    "list": (changed(b"float opacity", b"list int int opacity"), "vertex has the list opacity; export points without"),
    "lists of a billion rows": (
        lambda c: b"ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty list uchar int x\nend_header\n",
        "vertex has the list x",
    ),
    "faces": (changed(b"element vertex 7", b"element face 9\nproperty int a\nelement vertex 7"), "face, vertex, not v"),
    "no opacity": (changed(b" opacity", b" opaque"), "it has no opacity"),
    "negative count": (changed(b"element vertex 7", b"element vertex -7"), "has the line 'element vertex -7'"),
    "NaN": (lambda c: c[:-4] + np.float32("nan").tobytes(), "rot_3 of row 6 is not a finite number"),
    "infinite": (lambda c: c[:-4] + np.float32("-inf").tobytes(), "rot_3 of row 6 is not a finite number"),
}  # fmt: skip


@pytest.mark.parametrize(("spoil", "problem"), SPOILED.values(), ids=SPOILED)
def test_a_damaged_model_is_named_before_memory_is_taken(tmp_path, spoil, problem):
    path = tmp_path / "model.ply"
    save_ply(model(3, 1), path)
    content = path.read_bytes()
    path.write_bytes(spoil(content))
    assert path.read_bytes() != content

    def refused() -> None:
        with pytest.raises(ValueError, match=rf"model\.ply is not a 3DGS model: .*{re.escape(problem)}"):
            load_ply(path)

    assert peak_mb(refused) < 50


def test_a_degree_that_no_render_has_is_named(tmp_path):
    save_ply(model(3, 4), tmp_path / "model.ply")
    with pytest.raises(ValueError, match=r"24 f_rest coefficients per channel are no SH degree from 0 to 3"):
        load_ply(tmp_path / "model.ply")


@pytest.mark.parametrize("name", ["emissivity", "emissivity2", "e2_e"])
@pytest.mark.parametrize("shape", [(), (1,), (2,), (2, 3)])
def test_further_fields_are_read_again(tmp_path, name, shape):
    given = model(1, 0)
    field = torch.rand(len(given), *shape)
    save_ply(replace(given, extra_fields={name: field}), tmp_path / "model.ply")
    found = load_ply(tmp_path / "model.ply").extra_fields
    assert list(found) == [name] and torch.equal(found[name].reshape(field.shape), field)


def test_a_model_that_is_no_file_is_never_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo.ply")
    (tmp_path / "loop.ply").symlink_to(tmp_path / "loop.ply")
    for name, problem in {"fifo": "not a regular file", "loop": "symbolic links", "nothing": "No such file"}.items():
        with pytest.raises(ValueError, match=rf"{name}\.ply is not a 3DGS model: .*{problem}"):
            load_ply(tmp_path / f"{name}.ply")


@pytest.mark.parametrize("names", [("a_999999999_0", "b_0"), ("a_0_99999", "a_99999_0"), ("a_" + "9" * 5000, "b_0")])
def test_a_column_cannot_state_a_huge_field(tmp_path, names):
    fields = {"long_one": torch.zeros(7, 1), "long_two": torch.zeros(7, 1)}
    save_ply(replace(model(1, 0), extra_fields=fields), tmp_path / "model.ply")
    content = (tmp_path / "model.ply").read_bytes()
    for old, new in zip(("long_one_0", "long_two_0"), names, strict=True):
        content = content.replace(old.encode(), new.encode())
    (tmp_path / "model.ply").write_bytes(content)
    found = []
    assert peak_mb(lambda: found.extend(load_ply(tmp_path / "model.ply").extra_fields)) < 50
    assert found == [name for name in "ab" if f"{name}_0" in names]
