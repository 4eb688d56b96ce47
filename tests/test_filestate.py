"""Changed files and names are noticed; files are read only where their times do not decide."""

import os
import time

import pytest

from tdgbench import filestate
from tdgbench.filestate import CHANGED, FileState, States, made_state, merged, sha256, state_of, states_of


@pytest.fixture
def old(monkeypatch):
    """Nothing is recent, so that times alone decide."""
    monkeypatch.setattr(filestate, "RECENT_SECONDS", -60)


def test_a_recent_file_is_known_by_its_content(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"one")
    state = state_of(path)
    assert state.is_recent and state.sha256 == sha256(path) and state.is_of(path)
    before = path.stat()
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert not state.is_of(path)


def test_times_that_were_set_back_hide_no_change(tmp_path, old):
    path = tmp_path / "a"
    path.write_bytes(b"one")
    state, before = state_of(path), path.stat()
    assert not state.is_recent and state.sha256 is None and state.is_of(path)
    time.sleep(0.05)
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_mtime_ns == before.st_mtime_ns and not state.is_of(path)


def test_an_old_file_is_not_read(tmp_path, old, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"one")
    state = state_of(path)
    monkeypatch.setattr(filestate, "sha256", lambda path: pytest.fail("the file was read"))
    assert state.is_of(path)


def test_a_touched_file_is_read_where_its_content_is_known(tmp_path, old):
    path = tmp_path / "a"
    path.write_bytes(b"one")
    known, unknown = made_state(path.stat(), sha256(path)), state_of(path)
    os.utime(path, (1, 1))
    assert known.is_of(path) and not unknown.is_of(path)


def test_what_is_no_file_is_never_opened_and_never_as_it_was(tmp_path):
    fifo, nothing = tmp_path / "fifo", tmp_path / "nothing"
    os.mkfifo(fifo)
    assert [state_of(path) for path in (fifo, nothing, tmp_path)] == [CHANGED] * 3
    file = tmp_path / "a"
    file.write_bytes(b"")
    state = state_of(file)
    file.unlink()
    assert not state.is_of(file)
    os.mkfifo(file)
    assert not state.is_of(file) and not CHANGED.is_of(file)


def test_new_and_removed_names_are_noticed(tmp_path):
    (tmp_path / "in" / "deep").mkdir(parents=True)
    (tmp_path / "in" / "link").symlink_to(tmp_path)  # a loop
    tree, names = States(), States()
    tree.add_tree(tmp_path)
    names.add_names(tmp_path / "in")
    assert tree.is_now() and names.is_now()
    (tmp_path / "in" / "deep" / "a").touch()
    assert not tree.is_now() and names.is_now()
    (tmp_path / "in" / "b").touch()
    assert not names.is_now()
    gone = States()
    gone.add_tree(tmp_path / "nowhere")
    assert not gone.is_now()


def test_a_changed_file_is_noticed_among_others(tmp_path):
    paths = [tmp_path / name for name in "abc"]
    for path in paths:
        path.write_bytes(b"one")
    states = states_of(paths, trees=[tmp_path])
    assert states.is_now()
    paths[1].write_bytes(b"two")
    assert not states.is_now()


def test_states_that_disagree_have_no_union(tmp_path):
    a, b = (States({"/f": FileState(size, 0, 0, None, False)}, {"/n": "x"}) for size in (1, 2))
    assert merged([a, b]) is None and merged([a, a, States(trees={"/t": "y"})]) is not None
    assert merged([States(names={"/n": "x"}), States(names={"/n": "z"})]) is None
