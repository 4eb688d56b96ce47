"""Limits of a process that reads strangers' files, and an audit hook that notes what such files must not cause."""

from __future__ import annotations

import os
import resource
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any

import tdgbench

MARK = "strangers_mark"  # in all code that strangers' files hold; nobody may compile or run it
NEVER_IMPORTED = ("antigravity", "this", "turtledemo", "venv.__main__", "idlelib.idle", MARK)  # files name these
NEVER_RUN = tuple(f"/{name.replace('.', '/')}{end}" for name in NEVER_IMPORTED for end in (".py", "/__init__.py"))
BACKBONES = "download.pytorch.org"  # `score` may ask for LPIPS's networks, and is told that there is no network
ROOT = Path(tdgbench.__file__).resolve().parents[1]
SYSTEM = ("/proc/cpuinfo", "/proc/meminfo", "/dev/null", "/dev/urandom", "/sys", "/etc/localtime",
          "/usr/share/zoneinfo")  # fmt: skip
CACHES = ("tdgbench", "matplotlib", "fontconfig")  # below ~/.cache
STARTS = ("os.system", "os.exec", "os.posix_spawn", "os.startfile", "subprocess.Popen", "pty.spawn", "ctypes.dlopen")
WRITES = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.link", "os.symlink", "os.truncate",
          "shutil.rmtree", "shutil.move", "shutil.copyfile", "shutil.chown")  # fmt: skip
LISTS = ("open", "os.listdir", "os.scandir")
UNPICKLED = ("numba", "llvmlite", "numpy", "collections", "tdgbench", "copyreg")  # modules, of the cache of kernels
MOST_NOTED = 20

Note = Callable[[str], None]


def limit(more_bytes: int, file_bytes: int, seconds: int) -> None:
    """Allow this process so much more memory than it has, files up to a size, and so much processor time."""
    with open("/proc/self/status", encoding="ascii") as file:  # noqa: PTH123
        used = next(int(line.split()[1]) * 1024 for line in file if line.startswith("VmData"))
    resource.setrlimit(resource.RLIMIT_DATA, (used + more_bytes, used + more_bytes))
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def watch(folder: Path, note: Note) -> Callable[[], None]:
    """Note violations until the function that is returned is called.

    `folder` is the only one that may be written, and read beside what Python needs.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    own = str(folder.resolve())
    installed = [os.path.realpath(place) for place in (ROOT, sys.prefix, sys.base_prefix)]
    readable = (own, *installed, *(str(home / name) for name in CACHES), f"/proc/{os.getpid()}", *SYSTEM)
    writable = (own, str(home / CACHES[0]), "/dev/null")
    noted: set[str] = set()
    watching = True

    def tell(what: str) -> None:
        if what not in noted and len(noted) < MOST_NOTED:
            noted.add(what)
            note(what)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if not watching:
            return
        if event in LISTS:
            writes = event == "open" and _writes(*arguments[1:3])
            _check_place(event, arguments[0], writable if writes else readable, tell)
        elif event in WRITES:
            for path in arguments[:2] if event in ("os.rename", "os.link") else arguments[:1]:
                _check_place(event, path, writable, tell)
        elif event in ("exec", "compile"):
            _check_code(event, arguments, own, tell)
        elif event == "pickle.find_class":
            if arguments[0].partition(".")[0] not in UNPICKLED and arguments != ("builtins", "object"):
                tell(f"unpickles {arguments[0]}.{arguments[1]}")
        elif event in STARTS:
            if event != "ctypes.dlopen" or str(arguments[0]).startswith(own):
                tell(f"{event} of {str(arguments)[:200]}")
                raise PermissionError(f"{event} is not allowed here")
        elif event in ("socket.connect", "socket.getaddrinfo", "socket.bind", "urllib.Request"):
            if BACKBONES not in str(arguments):
                tell(f"{event} of {str(arguments)[:200]}")
            raise OSError("there is no network")

    def stop() -> None:
        nonlocal watching
        watching = False

    sys.addaudithook(hook)
    return stop


def settle(folder: Path) -> None:
    """Make `folder` the working folder, with its own folder for temporary files."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    os.environ["TMPDIR"], os.environ["TORCH_HOME"], tempfile.tempdir = (str(temporary),) * 3
    os.chdir(folder)


def _writes(mode: Any, flags: Any) -> bool:
    return bool(set(str(mode or "")) & set("wxa+")) or bool((flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def _check_place(event: str, path: Any, places: tuple[str, ...], tell: Note) -> None:
    if path is None or isinstance(path, int):
        return
    real = os.path.realpath(os.fsdecode(path))
    if not any(real == place or real.startswith(f"{place}/") for place in places):
        tell(f"{event} of {real[:200]}")


def _check_code(event: str, arguments: tuple[Any, ...], own: str, tell: Note) -> None:
    """Note code of a stranger's file, by its text or by the file that it was compiled from, and what nobody imports.

    Python has an event for the statement `import`, but none for `importlib.import_module`.
    """
    code = arguments[0]
    if isinstance(code, CodeType) and code.co_filename.endswith(NEVER_RUN):
        tell(f"imports {code.co_filename}")
    elif isinstance(code, CodeType) and (code.co_filename.startswith(own) or MARK in code.co_names):
        tell(f"runs code of {code.co_filename[:200]}")
    elif isinstance(code, str | bytes) and MARK in os.fsdecode(code):
        tell(f"{event}s {code[:60]!r}")
