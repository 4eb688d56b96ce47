from dataclasses import replace

from tdgbench.cells.record import Record
from tdgbench.tables.setup_notes import setup_facts, setup_notes


def record(method, length, seed=0):
    config = {"budget": {"name": "demo", "iterations": length}}
    return Record(method, "folder", "attic", "colmap", seed, "", "", config=config, iterations=length)


def test_budgets_of_several_lengths_name_their_methods():
    both = [record("tdg", 1200), record("msmg", 200)]
    assert setup_notes(both, timed=False) == [
        "number of seeds: 1; budget: demo, at most 1200 iterations (TDg), demo, at most 200 iterations (MSMG)"
    ]
    assert setup_notes(both[:1], timed=False) == ["number of seeds: 1; budget: demo, at most 1200 iterations"]


def test_when_trainings_ended_is_told():
    stopped = [record("tdg", 1200), replace(record("tdg", 1200, seed=1), iterations=800)]
    assert setup_notes(stopped, timed=False) == [
        "number of seeds: 2; budget: demo, at most 1200 iterations; ended after 800 to 1200"
    ]


def test_nothing_is_said_without_cells():
    assert setup_facts([], True) == setup_notes([], True) == []
