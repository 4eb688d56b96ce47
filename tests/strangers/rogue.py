"""What no stranger's file may cause, as functions that a server of `benchmarks.strangers` runs."""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import socket
import subprocess
from pathlib import Path

from benchmarks.strangers.watch import MARK


def reads_elsewhere(words: list[str]) -> int:
    return int(not Path("/etc/passwd").read_bytes())


def lists_elsewhere(words: list[str]) -> int:
    return int(not list(Path("/").iterdir()))


def writes_elsewhere(words: list[str]) -> int:
    Path("../elsewhere").write_bytes(b"x")
    return 0


def removes_elsewhere(words: list[str]) -> int:
    Path("../elsewhere").unlink(missing_ok=True)
    return 0


def follows_a_link(words: list[str]) -> int:
    Path("a.txt").symlink_to("/etc/passwd")
    return int(not Path("a.txt").read_bytes())


def imports(words: list[str]) -> int:
    importlib.import_module("turtledemo")
    return 0


def runs_a_file_of_the_case(words: list[str]) -> int:
    Path("code.py").write_text("x = 1\n", encoding="utf-8")
    exec(compile(Path("code.py").read_text(encoding="utf-8"), str(Path("code.py").resolve()), "exec"))
    return 0


def compiles_marked_text(words: list[str]) -> int:
    compile(f"{MARK}()", "<text>", "eval")
    return 0


def unpickles(words: list[str]) -> int:
    pickle.loads(pickle.dumps(subprocess.run))
    return 0


def starts_a_process(words: list[str]) -> int:
    subprocess.run(["true"])
    return 0


def asks_the_network(words: list[str]) -> int:
    socket.create_connection(("127.0.0.1", 9))
    return 0


def is_honest(words: list[str]) -> int:
    Path("a.txt").write_bytes(b"x")
    return int(Path("a.txt").read_bytes() != b"x")


def hangs(words: list[str]) -> int:
    while True:
        pass


def takes_memory(words: list[str]) -> int:
    return int(len(bytearray(5 * 2**28)) == 0)


def touches_memory(words: list[str]) -> int:
    pages = [bytearray(b"x" * 2**26) for _ in range(14)]
    return int(not pages)


def fills_the_disk(words: list[str]) -> int:
    for number in range(11):
        Path(f"{number}.bin").write_bytes(b"\0" * 10**8)
    return 0


def crashes(words: list[str]) -> int:
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def raises(words: list[str]) -> int:
    raise KeyError("scores")


def says_yes(words: list[str]) -> str:
    return "yes"


def prints_controls(words: list[str]) -> int:
    print("\x1b[2J")
    return 0


def succeeds(words: list[str]) -> int:
    return 0
