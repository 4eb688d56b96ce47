from tdgbench.cells.record import Record
from tdgbench.tables.setup_notes import setup_facts, setup_notes


def test_budgets_of_several_lengths_name_their_methods():
    lengths = {"tdg": 1200, "msmg": 200}
    records = [
        Record(name, "folder", "attic", "colmap", 0, "", "", config={"budget": {"name": "demo", "iterations": n}})
        for name, n in lengths.items()
    ]
    assert setup_notes(records, timed=False) == [
        "seeds: 1; budget: demo, at most 1200 iterations (TDg), demo, at most 200 iterations (MSMG)"
    ]
    assert setup_notes(records[:1], timed=False) == ["seeds: 1; budget: demo, at most 1200 iterations"]


def test_nothing_is_said_without_cells():
    assert setup_facts([], True) == setup_notes([], True) == []
