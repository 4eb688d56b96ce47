"""Machine-code cache: compiled kernels on disk, one folder per state of the sources and register width.

Numba checks only the file that defines a kernel, but a kernel bakes in helpers and constants of other files. Its
folder name therefore holds a fingerprint of `tdgbench.splats` and `tdgbench.fields`, the packages that have kernels.

A cache that cannot be read or written never ends a run: kernels are then compiled again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba.core.caching import FunctionCache

LOG = logging.getLogger(__name__)
PACKAGES = [Path(__file__).resolve().parents[2] / name for name in ("splats", "fields")]
WAIT_SECONDS = 120.0  # for another process that compiles a kernel; after them, both compile it
UNUSED_DAYS = 30  # after which the cache of another state of the sources is removed
_FOLDER = re.compile(r"[0-9a-f]{16}-\d+")
_DAY = 86_400.0  # seconds


def fingerprinted_files() -> list[Path]:
    """Return the source files that machine code may depend on."""
    return sorted(path for package in PACKAGES for path in package.rglob("*.py"))


def _fingerprint() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in fingerprinted_files():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_home() -> Path:
    """Return the folder of all of tdgbench's caches for this user.

    Raises RuntimeError if the environment names no folder for caches and the user has no home folder.
    """
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "tdgbench"


def cache_dir(lanes: int) -> Path:
    """Return the folder of these sources' machine code for registers of `lanes` floats; raises as `cache_home`."""
    return cache_home() / "numba" / f"{_fingerprint()}-{lanes}"


def open_cache(lanes: int) -> Path:
    """Create the folder, mark it as used now, and remove its unused siblings; returns the folder.

    If it cannot be written, a temporary one takes its place, with a warning, in XDG_CACHE_HOME as well: other
    libraries keep their caches there, and processes that this one starts need no second warning.
    """
    try:
        folder = cache_dir(lanes)
        _prepare(folder)
    except (OSError, RuntimeError) as error:
        home = _temporary_home()
        os.environ["XDG_CACHE_HOME"] = str(home)
        folder = cache_dir(lanes)
        with suppress(OSError):
            _prepare(folder)
        warnings.warn(
            f"compiled kernels are kept in {home}, as their cache cannot be used ({error}); "
            "set XDG_CACHE_HOME to a folder that can be written",
            stacklevel=2,
        )
    return folder


def _prepare(folder: Path) -> None:
    """Create a cache folder and look after its siblings. Raises OSError if no file can be written to it."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        os.utime(folder)
    with suppress(OSError):
        remove_unused(folder)


def _temporary_home() -> Path:
    """Return a folder for caches that only this user can write: machine code in it is run."""
    home = Path(tempfile.gettempdir()) / f"tdgbench-{os.getuid()}"
    with suppress(OSError):
        home.mkdir(mode=0o700, exist_ok=True)
        status = home.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022:
            return home
    return Path(tempfile.mkdtemp(prefix="tdgbench-"))


class KernelCache(FunctionCache):
    """Numba's cache of one kernel, which one process at a time compiles while others wait for it.

    Damaged files and a full disk cost no more than compiling again.
    """

    _lock: FileLock | None = None  # while this process compiles the kernel

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the stored machine code, or None to the one process that is to compile and save it."""
        found = self._load(sig, target_context)
        if found is None:
            self._acquire()
            found = self._load(sig, target_context)
            if found is not None:
                self.release()
        return found

    def _acquire(self) -> None:
        """Wait for a process that compiles the kernel. The lock is made anew: none survives a fork."""
        path = Path(self.cache_path) / f"{self._impl.filename_base}.lock"
        lock = FileLock(path, timeout=WAIT_SECONDS)
        with suppress(OSError, Timeout):
            lock.acquire()
            self._lock = lock

    def release(self) -> None:
        """Let other processes go on: the kernel is stored, or could not be compiled."""
        lock, self._lock = self._lock, None
        if lock is not None:
            with suppress(OSError):
                lock.release(force=True)

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # what reading a damaged file raises depends on the damage
            LOG.info("machine code in %s cannot be read; it is compiled again", self.cache_path, exc_info=True)
            self._forget()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception:
            self._forget()
        finally:
            self.release()

    def _forget(self) -> None:
        """Empty the index, which numba reads before it saves."""
        with suppress(OSError):
            self.flush()


def use_cache(compiled: Any, folder: Path) -> None:
    """Load a kernel of numba's `njit` from a folder, and store it there, if the folder can be used."""
    cache, compile_anew = _cache_of(compiled.py_func, folder), compiled._compiler.compile
    if cache is None:
        return

    def compile_and_release(*signature: Any) -> Any:
        try:
            return compile_anew(*signature)
        except BaseException:  # then nothing is saved, which would release the lock
            cache.release()
            raise

    compiled._cache, compiled._compiler.compile = cache, compile_and_release


def _cache_of(function: Callable[..., Any], folder: Path) -> KernelCache | None:
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)
    try:
        cache = KernelCache(function)
    except RuntimeError:  # numba found no place that can be written
        return None
    finally:
        numba.config.CACHE_DIR = previous
    # Numba's other places are shared by all states of the sources.
    return cache if Path(cache.cache_path).is_relative_to(folder) else None


def remove_unused(folder: Path) -> None:
    """Remove the siblings of a cache folder that no process opened for UNUSED_DAYS.

    A process that still uses one has its kernels in memory, and recreates the folder for the next one it compiles.
    """
    for sibling in folder.parent.iterdir():
        with suppress(OSError):  # another process removed it first
            is_old = time.time() - sibling.stat().st_mtime > UNUSED_DAYS * _DAY
            if sibling != folder and _FOLDER.fullmatch(sibling.name) and is_old:
                shutil.rmtree(sibling)
