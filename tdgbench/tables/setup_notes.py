"""What has to be known of the trainings behind a table, in lines for readers who have no report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tdgbench.cells.record import Record
from tdgbench.tables import methods
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
    said = [f"{name}: {values}" for name, values in setup_by_name(records, timed).items()]
    return ["; ".join(said)] if said else []


def setup_by_name(records: Sequence[Record], timed: bool) -> dict[str, str]:
    """Return `setup_facts` in words, by what they are of."""
    if not records:
        return {}
    seeds = Counter((method_label(one, with_init=True), one.dataset, one.scene) for one in records).values()
    facts = {
        "seeds": [" to ".join(map(str, sorted({min(seeds), max(seeds)})))],
        "budget": _budgets(records),
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


def _budgets(records: Sequence[Record]) -> list[str]:
    """Return each budget with its iterations, and with the methods that have them where not all have the same."""
    found: dict[str, dict[int, dict[str, None]]] = {}
    for one in records:
        if (name := one.setting("budget.name")) and one.made_elsewhere is None:
            of_length = found.setdefault(str(name), {}).setdefault(planned_iterations(one), {})
            of_length[methods.label(method_label(one, with_init=True))] = None
    return [
        f"{name}, "
        + " or ".join(f"{n} iterations" + f" ({named(who)})" * (len(lengths) > 1) for n, who in lengths.items())
        for name, lengths in found.items()
    ]
