"""What was run: the head of a report, from which a reader can judge and repeat it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tdgbench import __version__
from tdgbench.bench.commit import commit_in_words
from tdgbench.cells.plan import Plan
from tdgbench.cells.prior_sources import MADE_UP
from tdgbench.cells.record import READ_PHASE, Record
from tdgbench.tables.cell_names import Fact, method_on_scene, said
from tdgbench.tables.likeness import version
from tdgbench.tables.long_table import SPLITS
from tdgbench.tables.setup_notes import budgets

NOT_STATED = "not stated by the version that ran it"


def run_facts(plan: Plan, records: Sequence[Record]) -> list[tuple[str, list[str]]]:
    """Return titles and texts on finished cells: one text, or one for each value, with the cells that have it."""
    commands = [f"{one.words} ({one.date})" for one in plan.commands]
    facts = {"budget": budgets(records), "seeds": _seeds(records), **FACTS}
    if any(record.thermal_camera for record in records):
        facts["thermal camera"] = _thermal_camera
    return [
        ("commands; a cell is of the last that ran it" if len(commands) > 1 else "command", commands or [NOT_STATED]),
        *((title, said(fact, records)) for title, fact in facts.items() if records),
        ("this page", [f"made by tdgbench {__version__} ({commit_in_words()})"]),
    ]


def _seeds(records: Sequence[Record]) -> Fact:
    """Return what tells all seeds of a record's method on its scene."""
    seeds: dict[str, set[int]] = {}
    for record in records:
        seeds.setdefault(method_on_scene(record), set()).add(record.seed)
    return lambda record: ", ".join(map(str, sorted(seeds[method_on_scene(record)])))


def _machine(record: Record) -> str:
    e = record.environment
    device = ", ".join(map(str, _part(record, "gpu").values())) or "no GPU"
    threads = f"{e.get('threads')} thread{'s' * (e.get('threads') != 1)} a cell"
    at_once = e.get("cells_at_once")
    cells = f", {at_once} cells at once" if isinstance(at_once, int) and at_once > 1 else ""
    computer = f"{e.get('cpu') or NOT_STATED}, {e.get('cores')} cores"
    return f"{computer}, {threads}{cells}; {device}; backend {record.backend or 'n/a'}"


def _software(record: Record) -> str:
    packages = [f"{name} {version}" for name, version in _part(record, "packages").items() if version]
    e = record.environment
    return ", ".join([str(e.get("platform", NOT_STATED)), f"Python {e.get('python', NOT_STATED)}", *packages])


def _part(record: Record, name: str) -> dict[str, Any]:
    """Return a part of a record's environment; empty where it is null or no object."""
    part = record.environment.get(name)
    return part if isinstance(part, dict) else {}


def _prior(record: Record) -> str:
    """Say what was taken as depth prior: estimator, and what its maps are made from.

    >>> prior = {"estimator": "marigold", "model": "prs-eth/marigold-depth-v1-1", "made_from": "thermal images"}
    >>> _prior(Record("mine", "", "a", "", 0, "", "", prior=prior))
    'marigold (prs-eth/marigold-depth-v1-1), made from thermal images'
    """
    if record.prior is None:
        return "none"
    model, source = record.prior.get("model"), record.prior_source
    words = (source.in_full or record.prior_made_from) + source.in_report
    made = f", made from {words}" if words else ""
    return f"{record.prior.get('estimator', 'unknown')}{f' ({model})' if model else ''}{made}"


def _thermal_camera(record: Record) -> str:
    """Say what its estimate changed.

    >>> _thermal_camera(Record("mine", "", "a", "", 0, "", "", notes=["thermal camera: images stay as they are"]))
    'images stay as they are'
    """
    notes = [note.partition(": ")[2] for note in record.notes if note.startswith("thermal camera: ")]
    return "; ".join(notes) or "taken for ideal"


def _initial_points(record: Record) -> str:
    made = f"; {MADE_UP}"
    return f"{record.init}: {record.init_points.get('how', NOT_STATED)}{made * record.has_made_up_points}"


def _views(record: Record) -> str:
    views = " and ".join(f"{number} {name}" for name, number in record.views.items())
    return f"{views or NOT_STATED}; split {record.split or 'n/a'}: {SPLITS.get(record.split, record.split or 'n/a')}"


def _lpips(record: Record) -> str:
    net = record.setting("metrics.lpips.net")
    return f"{net or NOT_STATED}{'; LPIPS is n/a, see below the scores' * bool(record.missing.get('lpips'))}"


FACTS: dict[str, Fact] = {
    "image sizes": lambda record: record.assumed.get("size", NOT_STATED),
    "views": _views,
    "initial points": _initial_points,
    "depth prior": _prior,
    "LPIPS network": _lpips,
    "protocol": lambda record: f"{record.protocol or 'n/a'}, metrics as {record.convention or 'n/a'}",
    "version": lambda record: f"tdgbench {version(record)}",
    "machine": _machine,
    "software": _software,
}
OF_MACHINE = ("version", "machine", "software", "protocol")


def environments(records: Sequence[Record]) -> list[tuple[tuple[str, str], ...]]:
    """Return the distinct machines and versions that cells ran on; unreadable records say nothing of them."""
    known = [record for record in records if record.failure is None or record.failure.phase != READ_PHASE]
    return list(dict.fromkeys(tuple((title, FACTS[title](record)) for title in OF_MACHINE) for record in known))
