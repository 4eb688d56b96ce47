"""The cache follows every source that machine code depends on, and old caches go."""

import errno
import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import grimp
import numba
import pytest
from filelock import FileLock
from numba.core.caching import IndexDataCacheFile

from tdgbench.children import with_path
from tdgbench.splats.cpu import cache
from tests.helpers.paths import ROOT


@pytest.fixture(autouse=True)
def _numba_says_what_it_does(monkeypatch):
    """Print which files of the cache this process reads and writes; pytest shows that of a test that fails."""
    monkeypatch.setattr(numba.config, "DEBUG_CACHE", True)


def test_the_fingerprint_covers_everything_that_kernels_import():
    graph = grimp.build_graph("tdgbench", cache_dir=None)
    packages = ("splats", "fields")
    for kernels in ("tdgbench.splats.cpu", "tdgbench.fields"):
        imported = graph.find_upstream_modules(kernels, as_package=True)
        assert {name for name in imported if name.split(".")[1:2] != ["splats"]} <= {"tdgbench"}
    files = [path for package in packages for path in (ROOT / "tdgbench" / package).rglob("*.py")]
    assert {*files} == {*cache.fingerprinted_files()}


def test_the_folder_follows_the_sources_and_the_lanes(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    before = cache.cache_dir(8)
    assert before.is_relative_to(tmp_path) and cache.cache_dir(16) != before
    source = tmp_path / "kernel.py"
    monkeypatch.setattr(cache, "fingerprinted_files", lambda: [source])
    source.write_text("A = 1")
    first = cache.cache_dir(8)
    source.write_text("A = 2")
    assert len({before, first, cache.cache_dir(8)}) == 3


def test_only_unused_caches_are_removed(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = cache.open_cache(16)
    old, recent = folder.with_name("0123456789abcdef-16"), folder.with_name("fedcba9876543210-8")
    foreign = folder.with_name("notes")
    for place, days in ((folder, 99), (old, 31), (recent, 29), (foreign, 99)):
        place.mkdir(exist_ok=True)
        (place / "kernel.nbc").write_bytes(b"code")
        os.utime(place, (time.time() - days * 86_400,) * 2)
    assert cache.open_cache(16) == folder
    assert sorted(path.name for path in folder.parent.iterdir()) == sorted([folder.name, recent.name, foreign.name])
    assert (folder / "kernel.nbc").exists() and time.time() - folder.stat().st_mtime < 60  # marked as used


USE = """
import torch
from tdgbench.splats.cpu import jit
import numpy as np

@jit.kernel()
def double(x):
    return 2 * x

assert double(3) == 6
print(jit.CACHE_DIR, torch.hub.get_dir())
"""


def test_without_a_usable_cache_a_temporary_one_is_used(tmp_path):
    """Said once; other libraries' caches are there too."""
    home, temporary, script = tmp_path / "file", tmp_path / "temporary", tmp_path / "script.py"
    home.touch()
    script.write_text(USE)
    temporary.mkdir()
    env = {k: v for k, v in with_path(ROOT).items() if k != "TORCH_HOME"}
    env |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(temporary)}
    run = subprocess.run([sys.executable, script], env=env, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert run.stderr.count("their cache cannot be used") == 1 and str(home) in run.stderr
    assert list(temporary.rglob("script.double-*.nbc"))
    assert all(Path(path).is_relative_to(temporary) for path in run.stdout.split())


def test_a_temporary_cache_of_another_user_is_not_used(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    foreign = tmp_path / f"tdgbench-{os.getuid()}"
    foreign.mkdir()
    foreign.chmod(0o777)
    with pytest.warns(UserWarning, match="set XDG_CACHE_HOME to a folder that can be written"):
        folder = cache.open_cache(8)
    assert folder.is_dir() and not folder.is_relative_to(foreign)


KERNEL = """
def double(x):
    return 2 * x
"""


def compiled(tmp_path):
    """A kernel as a new process sees it: number of times it was loaded from the cache."""
    source = tmp_path / "kernels.py"
    source.write_text(KERNEL)
    spec = importlib.util.spec_from_file_location("kernels", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    function = numba.njit(module.double)
    cache.use_cache(function, tmp_path / "cache")
    assert function(3) == 6
    return sum(function.stats.cache_hits.values())


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", [b"", b"\x80\x05", None], ids=["empty", "foreign", "truncated"])
def test_a_damaged_cache_is_compiled_again(tmp_path, suffix, damage):
    assert (compiled(tmp_path), compiled(tmp_path)) == (0, 1)
    (file,) = tmp_path.rglob(f"*{suffix}")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2] if damage is None else damage)
    assert (compiled(tmp_path), compiled(tmp_path)) == (0, 1)


def test_a_full_disk_costs_only_the_cache(tmp_path, monkeypatch):
    def full(self, name, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "_save_data", full)
        assert compiled(tmp_path) == 0
    assert (compiled(tmp_path), compiled(tmp_path)) == (0, 1)


TOGETHER = """
import sys, time
from pathlib import Path
from tdgbench.splats.cpu import jit

@jit.kernel()
def double(x):
    return 2 * x

ready = Path(sys.argv[1])
(ready / sys.argv[2]).touch()
deadline = time.monotonic() + 120
while len(list(ready.iterdir())) < 2 and time.monotonic() < deadline:
    time.sleep(0.01)
assert double(3) == 6
print(sum(double.stats.cache_hits.values()))
"""


def test_of_two_processes_one_compiles_and_the_other_waits_for_it(tmp_path):
    script, ready = tmp_path / "script.py", tmp_path / "ready"
    script.write_text(TOGETHER)
    ready.mkdir()
    env = {**with_path(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    runs = [
        subprocess.Popen([sys.executable, script, ready, name], env=env, stdout=subprocess.PIPE, text=True)
        for name in "ab"
    ]
    assert sorted(run.communicate(timeout=300)[0].strip() for run in runs) == ["0", "1"]


def test_a_process_that_never_ends_compiling_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "WAIT_SECONDS", 0.05)
    (tmp_path / "cache").mkdir()
    assert compiled(tmp_path) == 0
    (lock,) = tmp_path.rglob("*double*.lock")
    for file in tmp_path.rglob("*.nb?"):
        file.unlink()
    with FileLock(lock):
        assert (compiled(tmp_path), compiled(tmp_path)) == (0, 1)


FAILING = """
import os
from filelock import FileLock
from tdgbench.splats.cpu import jit

@jit.kernel()
def wrong(x):
    return x.double

@jit.kernel()
def double(x):
    return 2 * x

try:
    wrong(3)
except Exception as error:
    print(type(error).__name__, flush=True)
child = os.fork()
if child == 0:
    (lock,) = jit.CACHE_DIR.rglob("*wrong*.lock")
    FileLock(lock).acquire(timeout=0)
    os._exit(double(3) != 6)
print(os.waitpid(child, 0)[1])
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this platform cannot fork")
def test_a_kernel_that_was_not_compiled_is_locked_no_longer_and_a_forked_child_compiles(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(FAILING)
    env = {**with_path(ROOT), "XDG_CACHE_HOME": str(tmp_path)}
    run = subprocess.run([sys.executable, script], env=env, capture_output=True, text=True, timeout=100)
    assert run.stdout.split() == ["TypingError", "0"], run.stderr


def test_places_that_other_sources_share_are_not_used(tmp_path):
    (tmp_path / "cache").touch()  # numba then takes __pycache__
    function = numba.njit(importlib.import_module("tdgbench.splats.cpu.cache").remove_unused)
    before = function._cache
    cache.use_cache(function, tmp_path / "cache")
    assert function._cache is before
