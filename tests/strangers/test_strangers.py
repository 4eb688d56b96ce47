"""Strangers' files run no code, take bounded time and memory, end in words; and the watch sees where they do not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.strangers.cases import OF_FOLDERS, OF_PACKS, Case, of_folder, of_pack, problems_of, run_case
from benchmarks.strangers.honest import Honest, make_honest
from benchmarks.strangers.server import Outcome, Server
from benchmarks.strangers.sweep import STRATEGIES
from tests.strangers import rogue
from tests.strangers.past import PAST

CASES = {"zip": 8, "record": 10, "table": 8, "ply": 8, "pickle": 6, "picture": 5, "scene": 8}


class Reader(NamedTuple):
    """A server, honest files, and a folder for cases."""

    server: Server
    honest: Honest
    folder: Path

    def problems(self, case: Case) -> list[str]:
        return run_case(self.server, case, self.folder)


@pytest.fixture(scope="module")
def reader(tmp_path_factory) -> Iterator[Reader]:
    place = tmp_path_factory.mktemp("strangers")
    with Server(patience=3) as server:  # another process of tests may share the cores
        yield Reader(server, make_honest(server, place / "honest"), place / "case")


@pytest.mark.parametrize("name", STRATEGIES)
def test_readers_stand_it(reader, name):
    @seed(1)
    @settings(max_examples=CASES[name], database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(STRATEGIES[name](reader.honest))
    def check(case: Case) -> None:
        assert reader.problems(case) == []

    check()


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


def outcome_of(reader: Reader, folder: Path, name: str, seconds: float = 20.0) -> tuple[Outcome, list[str]]:
    (folder / "case").mkdir()
    outcome = reader.server.run([f"{rogue.__name__}:{name}"], folder / "case", seconds=seconds)
    return outcome, problems_of(Case(name, {}, (), must_fail=name == "succeeds"), outcome)


@pytest.mark.parametrize(
    ("name", "what"),
    {
        "reads_elsewhere": "violation: open of /etc/passwd",
        "lists_elsewhere": "violation: os.listdir of /",
        "writes_elsewhere": "violation: open of ",
        "removes_elsewhere": "violation: os.remove of ",
        "follows_a_link": "violation: open of /etc/passwd",
        "imports": "violation: imports ",
        "runs_a_file_of_the_case": "violation: runs code of ",
        "compiles_marked_text": "violation: compiles ",
        "unpickles": "violation: unpickles subprocess.run",
        "starts_a_process": "violation: subprocess.Popen of ",
        "asks_the_network": "violation: socket.",
        "takes_memory": "wants more than 1 GB of memory",
        "fills_the_disk": "writes 1049 MB",
        "crashes": "is ended by signal 11",
        "raises": "unexpected error: KeyError: 'scores' (elsewhere)",
        "says_yes": "ends with status 'yes'",
        "prints_controls": "prints the control character '\\x1b'",
        "succeeds": "ends with status 0",
    }.items(),
)
def test_the_watch_sees(reader, tmp_path, name, what):
    assert any(problem.startswith(what) for problem in outcome_of(reader, tmp_path, name)[1])


def test_what_is_honest_is_no_problem(reader, tmp_path):
    assert outcome_of(reader, tmp_path, "is_honest")[1] == []


def test_what_hangs_is_ended(reader, tmp_path):
    outcome = outcome_of(reader, tmp_path, "hangs", seconds=0.5)[0]
    assert outcome.status is None and outcome.signal == 9 and 0.5 <= outcome.seconds < 5


def test_memory_is_measured(reader, tmp_path):
    assert 850 < outcome_of(reader, tmp_path, "touches_memory")[0].mb < 1000
