"""The cache follows every source that machine code depends on, and old caches go."""

import ast
import os
import time
from pathlib import Path

from tdgbench.splats.cpu import cache
from tests.helpers.paths import ROOT


def modules_imported_by(path: Path) -> set[Path]:
    """Files of this project that a file imports, at any level."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            place = ROOT / name.replace(".", "/")
            found |= {file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()}
    return found


def test_the_fingerprint_covers_everything_that_kernels_import():
    followed = {path.resolve() for path in cache.fingerprinted_files()}
    pending = sorted((ROOT / "tdgbench/splats/cpu").rglob("*.py"))
    imported = set()
    while pending:
        path = pending.pop()
        if path not in imported:
            imported.add(path)
            pending += modules_imported_by(path)
    assert {path.name for path in imported} >= {"columns.py", "harmonics.py", "blending.py"}
    assert imported <= followed


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


def test_a_folder_that_cannot_be_created_is_no_error(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert not cache.open_cache(8).exists()
