"""`tdgbench compare A B [--out DIR]`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from rich.table import Table
from rich.text import Text

from tdgbench.compare import compared_cells as compared
from tdgbench.compare.causes import KINDS, Cause, find_causes, in_brief, is_of_times, why_no_times
from tdgbench.compare.compared_cells import FIRST, IDENTICAL, NOT_COMPARED, ONE_TRAINING, OTHER_DATA, TWO_PROTOCOLS
from tdgbench.compare.comparison_page import write_page
from tdgbench.compare.pairs import PLACE, Pairs, find_pairs, place_of
from tdgbench.files import write_text
from tdgbench.packs import opened_pack
from tdgbench.tables.as_csv import as_csv
from tdgbench.tables.assumptions import DOUBTS, UNSTATED, AssumedDifference, assumed_differences, doubts_of
from tdgbench.tables.build import COLUMN_OF
from tdgbench.tables.columns import own_columns
from tdgbench.tables.findings import before_a_plateau, given_priors
from tdgbench.tables.likeness import selected_notes
from tdgbench.tables.long_table import iterations_in_words, planned_iterations
from tdgbench.tables.measures import RecordMeasure, measure_of
from tdgbench.tables.results import Results, read_results
from tdgbench.tables.setup_notes import setup_by_name
from tdgbench.tables.verdicts import UNDECIDED
from tdgbench.terminal import console, errors_in_one_line, say
from tdgbench.text import named, one_line

MOST_CAUSES = 12  # of a kind, on the terminal
ESTIMATED = "renders are scored as the estimated thermal camera shows them, where that predicts training views better"


@errors_in_one_line("compare", status=2)
def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a score is `better` or `worse`, or of two protocols or data."""
    parser = argparse.ArgumentParser(
        prog="tdgbench compare", description="Compare two result folders, cell by cell: of two machines, versions, "
        "backends, settings. Differences are B − A.",
    )  # fmt: skip
    parser.add_argument("a", type=Path, metavar="A", help="folder results/<experiment>, or a pack")
    parser.add_argument("b", type=Path, metavar="B", help="another one")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write compare.csv and compare.html there")
    options = parser.parse_args(arguments)
    with opened_pack(options.a) as a, opened_pack(options.b) as b:
        results = _read(a), _read(b)
        with own_columns(*(one.plan for one in results)):
            return _compare(*results, shown_paths(options.a, options.b), options.out)


def shown_paths(a: Path, b: Path) -> tuple[str, str]:
    """Return two paths as they were typed; absolute ones as the shortest ends that differ, since pages go to others.

    >>> shown_paths(Path("results/own"), Path("/home/ada/results/own")), shown_paths(Path("/a/b/c"), Path("/a/d/c"))
    (('results/own', '.../own'), ('.../b/c', '.../d/c'))
    """
    ends = next((n for n in range(1, len(a.parts)) if a.parts[-n:] != b.parts[-n:]), 1)
    mine, theirs = (
        f".../{'/'.join(path.parts[-ends:])}" if path.is_absolute() and len(path.parts) > ends else str(path)
        for path in (a, b)
    )
    return mine, theirs


def _compare(a: Results, b: Results, names: tuple[str, str], out: Path | None) -> int:
    pairs = find_pairs(a.cells, b.cells)
    if not len(pairs):
        raise ValueError(f"{a.folder} and {b.folder} share no finished cell: none has the same method, scene, initial "
                         "points, variant and seed")  # fmt: skip
    causes, otherwise = find_causes(pairs), assumed_differences((pair.a.record, pair.b.record) for pair in pairs)
    table = compared.score_table(pairs, causes)
    findings = [*assumed_in_words(otherwise), *findings_of(table, causes, pairs)]
    for one in otherwise[:MOST_CAUSES]:
        say(one_line(one.sentence), "assumed:", "bold")
    if len(otherwise) > MOST_CAUSES:
        say(f"{len(otherwise) - MOST_CAUSES} more that differ, which --out writes", "assumed:", "bold")
    _show(table, causes, len(pairs), findings)
    for sentence in findings:
        say(sentence, "found:", "bold")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "compare.csv", as_csv(table, na_rep="n/a"))
        write_page(out / "compare.html", names, findings, table, causes, pairs, otherwise)
        say(f"{out / 'compare.csv'}, {out / 'compare.html'}")
    differs = table["verdict"].isin(["better", "worse"]).any()
    return int(differs or table["reason"].str.startswith((TWO_PROTOCOLS, OTHER_DATA, compared.CHANGED)).any())


def _read(experiment: Path) -> Results:
    """Read an experiment, and say its problems. Raises ValueError without a finished cell."""
    results = read_results(experiment)
    for problem in results.problems:
        say(one_line(problem), "problem:")
    if not results.finished:
        raise ValueError(f"{experiment} holds no finished cell")
    return results


def assumed_in_words(differences: Sequence[AssumedDifference]) -> list[str]:
    """Return the finding that the two read their files in other ways, and in which; empty if they did not."""
    names = dict.fromkeys(one.name for one in differences if UNSTATED not in (one.a, one.b) and one.name != DOUBTS)
    scenes = len({one.scene for one in differences if one.name in names})
    if not names:
        return []
    where = f"{scenes} scene{'s' if scenes > 1 else ''}"
    return [f"assumed differently, in {where}: {one_line(', '.join(names))}; their numbers may be of other images"]


def findings_of(table: pd.DataFrame, causes: Sequence[Cause], pairs: Pairs) -> list[str]:
    """Return what a comparison found, one sentence each: verdicts, what differs, cells of one experiment alone."""
    found, heads = [], compared.place_heads(table)
    if len(changed := table.loc[table["reason"] == compared.CHANGED, "metric"].unique()):
        labels = named(measure_of(name).label for name in changed)
        found.append(f"a record was changed: renders, ground truth and protocol are equal, {labels} not; run tdgbench "
                     "verify on both")  # fmt: skip
    is_score = [not isinstance(measure_of(name), RecordMeasure) for name in table["metric"]]
    of_scores = table.loc[is_score, "verdict"]
    sentences = compared.verdicts(table, pairs)
    if set(of_scores) - {NOT_COMPARED} == {IDENTICAL}:
        rows = table[np.array(is_score) & (table["verdict"] == IDENTICAL)].drop_duplicates(PLACE)
        cells = int(rows["seeds"].sum())
        found.append(f"all scores that are compared are identical, in {cells} cell{'s' * (cells > 1)}")
        sentences = [sentence for sentence in sentences if NOT_COMPARED in sentence]
    found += [*sentences, *of_failures(pairs)]
    if (table.loc[table["verdict"] == UNDECIDED, "seeds"] == 1).any():
        found.append("one seed has no interval, so its scores are undecided: run both with seed=0,1,2")
    for name, alone in (("A", pairs.only_a), ("B", pairs.only_b)):
        means_of: dict[str, list[str]] = {}
        for place, by_seed in pairs.by_place.items():
            if further := sorted({record.seed for record in alone if place_of(record) == place}):
                both, more = (
                    f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, sorted(seeds)))}" for seeds in (by_seed, further)
                )
                said = f"means are over {both}, which both have; {name} has {more} as well, which its tables average"
                means_of.setdefault(said, []).append(compared.place_in_words(place, heads))
        found += [said if len(who) == len(pairs.by_place) else f"{named(who)}: {said}"
                  for said, who in means_of.items()]  # fmt: skip
    once = sum(pair.is_one_training for pair in pairs)
    if once:
        some = "" if once == len(pairs) else f" in {once} of {len(pairs)} cells"
        found.append(f"{ONE_TRAINING}{some}: models, renders and logs of A and B are equal (scored again, or copied), "
                     "so there is no repeat and no second time")  # fmt: skip
    found += of_times(pairs, causes, heads)
    kinds = []
    for kind in KINDS:
        of_kind = [cause for cause in causes if cause.kind == kind]
        scopes = {cause.scope for cause in of_kind}
        what = in_brief(of_kind) if "" in scopes else ", ".join(sorted(scopes))
        kinds += [f"{kind} ({what})"] if of_kind else []
    found.append(f"what differs: {', '.join(kinds)}" if kinds else "settings, data, code and machine are the same")
    found += of_ends(pairs)
    of_both = [setup_by_name(records, timed=True) for records in pairs.sides]
    shared = [f"{name}: {value}" for name, value in of_both[0].items() if of_both[1].get(name) == value]
    found += [f"the same in both, of the cells that are compared: {'; '.join(shared)}"] * bool(shared)
    found += evidence_of_scores(pairs)
    found.append("not checked here: whether the stored ground truth is the data's (tdgbench verify)")
    for name, alone, failed in (("A", pairs.only_a, pairs.failed_b), ("B", pairs.only_b, pairs.failed_a)):
        if titles := {record.title for record in alone} - {record.title for record in failed}:
            found.append(f"finished in {name} alone: {named(sorted(titles))}")
    return found


def of_failures(pairs: Pairs) -> list[str]:
    """Return which cells failed in one experiment or both: means leave them out."""
    return [
        f"failed in {where}: {named(f'{one.title} ({one.why_failed})' for one in failed)}; means leave them out"
        for where, failed in (
            ("A, not in B", pairs.failed_a), ("B, not in A", pairs.failed_b), ("A and B", pairs.failed_both)
        ) if failed
    ]  # fmt: skip


def of_ends(pairs: Pairs) -> list[str]:
    """Return after how many iterations rules ended trainings of equal plans, where that differs."""
    unlike = [
        (a.record, b.record) for a, b in pairs
        if a.record.iterations != b.record.iterations and planned_iterations(a.record) == planned_iterations(b.record)
    ]  # fmt: skip
    if not unlike:
        return []
    a, b = (iterations_in_words(records) for records in zip(*unlike, strict=True))
    return [f"rules ended trainings after {a} in A, {b} in B, iterations, in {len(unlike)} of {len(pairs)} cells: an "
            "outcome, no setting"]  # fmt: skip


def evidence_of_scores(pairs: Pairs) -> list[str]:
    """Return what depth priors are made from, what is doubted, and what the scores are no evidence of."""
    trained = [cell.record for pair in pairs for cell in pair]
    priors = [given_priors(records) for records in pairs.sides]
    no_more = "no depth prior of more than thermal images"
    found: list[str] = priors[0] if priors[0] == priors[1] else [
        "; ".join(f"in {name}: {' and '.join(said) or no_more}" for name, said in zip("AB", priors, strict=True))
    ]  # fmt: skip
    for name, records in zip("AB", pairs.sides, strict=True):
        found += [f"in {name}: {note}" for note in selected_notes(records, COLUMN_OF)]
        found += [f"in {name}, {ESTIMATED}"] * any(one.setting("thermal_camera.estimate") is True for one in records)
    found += before_a_plateau(trained)
    doubts = doubts_of(trained)
    found += [f"doubt: {doubt}" for doubt in doubts[:MOST_CAUSES]]
    found += [f"{len(doubts) - MOST_CAUSES} more doubts"] * (len(doubts) > MOST_CAUSES)
    built_in = ["built-in scenes: no evidence on the paper's claims"] * all(one.is_of_built_in_scene for one in trained)
    return found + built_in


def of_times(pairs: Pairs, causes: Sequence[Cause], heads: Sequence[str]) -> list[str]:
    """Return of which cells times do not compare, and what else than the training may change the others'.

    heads: columns of PLACE that name a place.
    """
    found: dict[str, list[str]] = {}
    for place in pairs.by_place:
        here = [cause for cause in causes if place in cause.places]
        settings = in_brief(cause for cause in here if is_of_times(cause))
        code = " or of the code" * any(cause.name == "code" for cause in here)
        if why := why_no_times(here):
            found.setdefault(f"do not compare: {why}", []).append(compared.place_in_words(place, heads))
        elif settings:
            said = f"may differ because of the machine's settings{code}: {settings}"
            found.setdefault(said, []).append(compared.place_in_words(place, heads))
    return [f"times{'' if len(who) == len(pairs.by_place) else f' of {named(who)}'} {said}"
            for said, who in found.items()]  # fmt: skip


def _show(table: pd.DataFrame, causes: Sequence[Cause], pairs: int, findings: Sequence[str]) -> None:
    """Print the scores that tables print, and what differs."""
    printed = compared.comparison_grid(table[table["metric"].isin(FIRST)], findings)
    shown = Table(*printed.heads, *printed.columns)
    for row in printed.rows:
        shown.add_row(*(Text(one_line(head)) for head in row.heads), *(cell.text or cell.note for cell in row.cells))
    console().print(shown)
    for note in (*printed.notes, *compared.legend(table)):
        say(one_line(note))
    for kind, meaning in KINDS.items():
        some = [cause for cause in causes if cause.kind == kind]
        for cause in some[:MOST_CAUSES]:
            say(one_line(cause.sentence(pairs)), f"{kind}:", "bold")
        if len(some) > MOST_CAUSES:
            say(f"{len(some) - MOST_CAUSES} more settings that differ ({meaning})", f"{kind}:", "bold")
