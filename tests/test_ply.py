"""The header of a PLY file is checked against its size before a row is read; honest files are read as plyfile does."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from tdgbench.ply import HEADER_SIZE, read_ply
from tests.helpers.memory import peak_mb

KINDS = {"u1": 3, "i1": -3, "u2": 300, "i2": -300, "u4": 70_000, "i4": -70_000, "f4": 0.1, "f8": 0.1}


def written(text: bool = False, order: str = "<", **details: object) -> bytes:
    """A file of three vertices with columns of all kinds, and two rows of another element."""
    rows = np.zeros(3, [(kind, kind) for kind in KINDS])
    for kind, value in KINDS.items():
        rows[kind] = value
    other = np.array([(1.5,), (2.5,)], [("w", "f8")])
    out = io.BytesIO()
    elements = [PlyElement.describe(rows, "vertex"), PlyElement.describe(other, "other")]
    PlyData(elements, text=text, byte_order=order, comments=["made by a test"], **details).write(out)
    return out.getvalue()


@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")], ids=["text", "little", "big"])
def test_honest_files_are_read_as_plyfile_does(tmp_path, text, order, mapped):
    content = written(text, order)
    (tmp_path / "a.ply").write_bytes(content)
    with (tmp_path / "a.ply").open("rb") if mapped else io.BytesIO(content) as file:
        found, expected = read_ply(file), PlyData.read(tmp_path / "a.ply")
        for element in expected:
            assert np.array_equal(found[element.name].data, element.data)
            assert isinstance(found[element.name].data, np.memmap) == (mapped and not text)


def header(*lines: str, kind: str = "ascii", end: str = "\n") -> bytes:
    return end.join(["ply", f"format {kind} 1.0", *lines, "end_header", ""]).encode()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_blanks_and_comments(end):
    lines = ["comment a  b", "obj_info c", " ", "  element  vertex 2", "comment", "property float32 x"]
    content = header(*lines, end=end) + f"1{end}2".encode()  # without a line end behind the last number
    assert read_ply(io.BytesIO(content))["vertex"]["x"].tolist() == [1, 2]


def test_an_element_without_rows_may_have_lists():
    """MeshLab writes one of faces beside a cloud of points."""
    faces = ["element face 0", "property list uchar int vertex_indices"]
    content = header("element vertex 1", "property float x", *faces) + b"1\n"
    assert len(read_ply(io.BytesIO(content))["vertex"]) == 1


LITTLE = "binary_little_endian"
LIST = "property list uchar int a"
BILLION = "element vertex 1000000000"
HOSTILE: dict[str, tuple[bytes, str]] = {
    "lists of a billion rows": (header(BILLION, LIST, kind=LITTLE), "export points without faces"),
    "lists as text": (header(BILLION, LIST), "vertex has the list a; export points without faces"),
    "lists of another element": (header("element a.b 9", LIST, "element vertex 0"), "a.b has the list a"),
    "a billion rows": (header(BILLION, "property uchar x", kind="binary_big_endian"), "than the file has bytes for"),
    "a billion rows of text": (header(BILLION, "property uchar x") + b"1\n", "than the file has bytes for"),
    "of an odd element": (header("element a.b 1000000000", "property uchar x"), "than the file has bytes for"),
    "of many elements": (
        header(*(f"element e{n} 9\nproperty uchar x" for n in range(1000))) + b"1\n" * 8999, "than the file has bytes",
    ),
    "rows of nothing": (header(BILLION), "element vertex has rows without a property"),
    "one row of text": (header("element vertex 1", "property int x") + b"11 " * 10**6, "a row of more than 1048576"),
    "one row too few": (header("element vertex 9", "property uchar x", kind=LITTLE) + bytes(8), "early"),
    "a byte too many": (header("element vertex 9", "property uchar x", kind=LITTLE) + bytes(10), "goes"),
    "no PLY": (b"hello", "does not begin with the line 'ply'"),
    "nothing": (b"", "does not begin with the line 'ply'"),
    "no end": (b"ply\nformat ascii 1.0\n", "no end_header in its first"),
    "a long header": (header("comment " + "x" * HEADER_SIZE), "no end_header in its first 65536 bytes"),
    "other line ends": (header("element vertex 1\rfoo", "property int x"), r"the line 'element vertex 1\\rfoo'"),
    "no format": (b"ply\nelement vertex 0\nend_header\n", "no format"),
    "a format too many": (header("format ascii 1.0"), "has the line 'format ascii 1.0'"),
    "another version": (header().replace(b"1.0", b"2.0"), "has the line 'format ascii 2.0'"),
    "another format": (header(kind="middle"), "has the line 'format middle 1.0'"),
    "a negative count": (header("element vertex -7"), "has the line 'element vertex -7'"),
    "an underscore": (header("element vertex 1_0"), "has the line 'element vertex 1_0'"),
    "an astronomic count": (header("element vertex " + "9" * 5000), "has the line 'element vertex 999"),
    "no element": (header("property int x"), "has the line 'property int x'"),
    "another kind": (header("element vertex 1", "property f4 x"), "has the line 'property f4 x'"),
    "a column twice": (header("element vertex 0", "property int x", "property int x"), "two properties with same name"),
    "an element twice": (header("element vertex 0", "element vertex 0"), "two elements with same name"),
    "a number that does not fit": (header("element vertex 1", "property char x") + b"300\n", "300|malformed"),
    "a word": (header("element vertex 1", "property float x") + b"abc\n", "malformed input"),
    "no ASCII": (header("comment \N{EURO SIGN}"), "can't decode"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "problem"), HOSTILE.values(), ids=HOSTILE)
def test_a_file_that_is_refused_takes_no_memory(content, problem):
    assert_refused(lambda: read_ply(io.BytesIO(content)), problem)


def test_other_elements_where_one_is_expected():
    assert_refused(
        lambda: read_ply(io.BytesIO(written()), only="vertex"), "elements are vertex, other, not vertex alone"
    )


def assert_refused(read: Callable[[], object], problem: str) -> None:
    def refused() -> None:
        with pytest.raises(ValueError, match=problem) as error:
            read()
        assert len(str(error.value)) < 400 and "\n" not in str(error.value)

    assert peak_mb(refused) < 50
