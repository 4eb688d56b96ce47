"""Strangers' files run no code, take bounded time and memory, end in words; and the watch sees where they do not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from benchmarks.strangers.cases import OF_FOLDERS, OF_PACKS, Case, of_folder, of_pack, problems_of, run_case
from benchmarks.strangers.honest import Honest, make_honest
from benchmarks.strangers.server import Outcome, Server
from benchmarks.strangers.sweep import STRATEGIES, made
from benchmarks.strangers.watch import MARK
from tests.strangers import rogue
from tests.strangers.past import PAST

CASES = {"zip": 8, "record": 10, "table": 8, "ply": 8, "pickle": 6, "picture": 5, "scene": 8}


class Reader(NamedTuple):
    """A server, honest files, and a folder for cases."""

    server: Server
    honest: Honest
    folder: Path

    def problems(self, case: Case) -> list[str]:
        return run_case(self.server, case, self.folder)[1]


@pytest.fixture(scope="module")
def reader(tmp_path_factory) -> Iterator[Reader]:
    place = tmp_path_factory.mktemp("strangers")
    with Server(patience=3) as server:  # another process of tests may share the cores
        yield Reader(server, make_honest(server, place / "honest"), place / "case")


@pytest.mark.parametrize("name", STRATEGIES)
def test_readers_stand_it(reader, name):
    for number in range(CASES[name]):
        assert reader.problems(made(name, reader.honest, 1, number)) == []


@pytest.mark.parametrize("tool", OF_PACKS)
def test_an_honest_pack_is_no_problem(reader, tool):
    pack = (reader.honest.folder / "honest.zip").read_bytes()
    assert reader.problems(of_pack(reader.honest, pack, "honest", tool)) == []


@pytest.mark.parametrize("tool", OF_FOLDERS)
def test_an_honest_folder_is_no_problem(reader, tool):
    assert reader.problems(of_folder(reader.honest.pack, "honest", tool)) == []


@pytest.mark.parametrize("make", PAST.values(), ids=PAST)
def test_what_once_failed(reader, make):
    assert reader.problems(make(reader.honest)) == []


def outcome_of(reader: Reader, folder: Path, code: str, seconds: float = 20.0) -> tuple[Outcome, list[str]]:
    """Run code as a tool whose success would be false if the code is empty."""
    (folder / "case").mkdir()
    outcome = reader.server.run([f"{rogue.__name__}:run", code], folder / "case", seconds=seconds)
    return outcome, problems_of(Case(code, {}, (), must_fail=not code), outcome)


@pytest.mark.parametrize(
    ("code", "what"),
    {
        "Path('/etc/passwd').read_bytes()": "violation: open of /etc/passwd",
        "list(Path('/').iterdir())": "violation: os.listdir of /",
        "Path('../elsewhere').write_bytes(b'x')": "violation: open of ",
        "Path('../elsewhere').unlink(missing_ok=True)": "violation: os.remove of ",
        "Path('a').symlink_to('/etc/passwd'); Path('a').read_bytes()": "violation: open of /etc/passwd",
        "importlib.import_module('turtledemo')": "violation: imports ",
        "exec(compile('x = 1', str(Path('code.py').resolve()), 'exec'))": "violation: runs code of ",
        f"compile('{MARK}' + '()', '<text>', 'eval')": "violation: compiles ",
        "pickle.loads(pickle.dumps(subprocess.run))": "violation: unpickles subprocess.run",
        "subprocess.run(['true'])": "violation: subprocess.Popen of ",
        "socket.create_connection(('127.0.0.1', 9))": "violation: socket.",
        "bytearray(5 * 2**28)": "wants more than 1 GB of memory",
        "[Path(f'{n}.bin').write_bytes(bytes(10**8)) for n in range(11)]": "writes 1049 MB",
        "os.kill(os.getpid(), signal.SIGSEGV)": "is ended by signal 11",
        "raise KeyError('scores')": "unexpected error: KeyError: 'scores' (elsewhere)",
        "status = 'yes'": "ends with status 'yes'",
        "print('\x1b[2J')": "prints the control character '\\x1b'",
        "": "ends with status 0",
    }.items(),
)
def test_the_watch_sees(reader, tmp_path, code, what):
    assert any(problem.startswith(what) for problem in outcome_of(reader, tmp_path, code)[1])


def test_what_is_honest_is_no_problem(reader, tmp_path):
    assert outcome_of(reader, tmp_path, "Path('a').write_bytes(b'x'); Path('a').read_bytes()")[1] == []


def test_what_hangs_is_ended(reader, tmp_path):
    outcome = outcome_of(reader, tmp_path, "while True: pass", seconds=0.5)[0]
    assert outcome.status is None and outcome.signal == 9 and 0.5 <= outcome.seconds < 5


def test_memory_is_measured(reader, tmp_path):
    touches = "pages = [bytearray(b'x' * 2**26) for _ in range(14)]"
    assert 850 < outcome_of(reader, tmp_path, touches)[0].mb < 1000
