"""What has to be known of the trainings behind a table, in lines for readers who have no report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tdgbench.cells.record import Record
from tdgbench.tables.cell_names import Fact, said
from tdgbench.tables.findings import before_a_plateau, given_priors
from tdgbench.tables.likeness import machine, machine_in_words
from tdgbench.tables.long_table import method_label, planned_iterations
from tdgbench.text import named


def setup_notes(records: Sequence[Record], timed: bool) -> list[str]:
    """Return what has to be known of the trainings behind a table: scenes, priors, end, and `setup_facts`."""
    if not records:
        return []
    notes = ["Built-in scenes: no evidence on the paper's claims."] * any(one.is_of_built_in_scene for one in records)
    return [*notes, *given_priors(records), *before_a_plateau(records), *setup_facts(records, timed)]


def setup_facts(records: Sequence[Record], timed: bool) -> list[str]:
    """Return a line with seeds, budget, images, LPIPS network and, of times, machine of cells; none without any."""
    line = "; ".join(f"{name}: {values}" for name, values in setup_by_name(records, timed).items())
    return [line] if line else []


def setup_by_name(records: Sequence[Record], timed: bool) -> dict[str, str]:
    """Return `setup_facts` in words, by what they are of."""
    if not records:
        return {}
    seeds = Counter((method_label(one, with_init=True), one.dataset, one.scene) for one in records).values()
    facts = {
        "number of seeds": [" to ".join(map(str, sorted({min(seeds), max(seeds)})))],
        "budget": said(budgets(records), records),
        "images": [
            f"{one.assumed['size']}, {one.views['test']} test views"
            for one in records
            if "size" in one.assumed and "test" in one.views
        ],
        "LPIPS network": [
            record.setting("metrics.lpips.net") for record in records if record.scores.get("lpips") is not None
        ],
        "machine of the times": [
            machine_in_words(machine(one)) for one in records if timed and one.environment and one.seconds.get("train")
        ],
    }
    listed = {name: named(str(value) for value in values if value) for name, values in facts.items()}
    return {name: values for name, values in listed.items() if values}


def budgets(records: Sequence[Record]) -> Fact:
    """Return what tells a record's budget, and when the trainings with this budget ended."""
    ends: dict[str, set[int]] = {}
    for record in records:
        ends.setdefault(_planned(record), set()).add(record.iterations)

    def budget(record: Record) -> str:
        first, last = min(ends[_planned(record)]), max(ends[_planned(record)])
        if record.made_elsewhere is not None or first == last == planned_iterations(record):
            return _planned(record)
        return f"{_planned(record)}; ended after {f'{first} to ' * (first < last)}{last}"

    return budget


def _planned(record: Record) -> str:
    if record.made_elsewhere is not None:
        return "trained elsewhere"
    return f"{record.setting('budget.name') or 'unnamed'}, at most {planned_iterations(record)} iterations"
