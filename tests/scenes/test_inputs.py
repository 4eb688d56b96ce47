import os
import socket

import numpy as np
import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import check_view_name, is_there, listed, read_array, read_bytes, regular_file


def a_socket(path):
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (os.mkfifo, "is a FIFO, not a file"),
        (lambda path: path.mkdir(), "is a folder, not a file"),
        (lambda path: path.symlink_to("/dev/zero"), "is a device, not a file"),
        (a_socket, "is a socket, not a file"),
        (lambda path: path.symlink_to(path), "cannot be used: Too many levels of symbolic links"),
        (lambda path: path.symlink_to(path.parent / "nothing"), "it links to nothing"),
        (lambda path: None, "No such file"),
    ],
)
def test_only_regular_files_are_opened(tmp_path, monkeypatch, make, message):
    monkeypatch.chdir(tmp_path)  # the names of sockets are short
    path = tmp_path / "x"
    make(path if make is not a_socket else path.relative_to(tmp_path))
    for read in (regular_file, read_bytes, read_array):
        with pytest.raises(SceneError) as error:
            read(path)
        assert message in str(error.value) and str(path) in str(error.value)


def test_links_to_files_are_followed(tmp_path):
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").symlink_to("a")
    assert read_bytes(tmp_path / "b") == b"1" and is_there(tmp_path / "b") and not is_there(tmp_path / "c")


def test_folders_that_cannot_be_listed(tmp_path, monkeypatch):
    (tmp_path / "b").mkdir()
    (tmp_path / "a").mkdir()
    assert [p.name for p in listed(tmp_path)] == ["a", "b"]

    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.iterdir", refuse)
    with pytest.raises(SceneError, match="cannot be listed: no permission to read it; change its permissions"):
        listed(tmp_path)


def test_arrays(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.ones((2, 3), np.float32))
    assert read_array(path).shape == (2, 3) and type(read_array(path)) is np.ndarray
    whole = path.read_bytes()
    shapes = [whole.replace(b"(2, 3), ", shape) for shape in (b"(2**60,)", b"(9**9,) ", b"(10000,)", b"(-2, 3),")]
    bad = [whole[:-1], whole[:20], b"", b"nothing", *shapes]
    for data in bad:
        path.write_bytes(data)
        with pytest.raises(SceneError, match=r"a\.npy cannot be read as an \.npy array"):
            read_array(path)
    for values in (np.array([1j]), np.array(["a"]), np.array([True])):
        np.save(path, values)
        with pytest.raises(SceneError, match="it must hold one array of real numbers"):
            read_array(path)
    np.save(path, np.array([object()]))
    with pytest.raises(SceneError, match="Python objects"):
        read_array(path)


@pytest.mark.parametrize("name", ["", " ", ".", "..", "a\nb", "a\0b", "\x1b[31m", "é" * 101])
def test_view_names_that_no_file_could_have(name):
    with pytest.raises(SceneError, match=r"^here gives a view the name"):
        check_view_name(name, "here")
    assert check_view_name("a b é $%_[red]", "here")
