"""Ranks and bold type across packs: one ranking a scene, protocol and budget, of rows of the same images."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tdgbench.cells.folder import shared_content
from tdgbench.cells.key import differences
from tdgbench.site.packed import SCORES, BoardRow
from tdgbench.tables.comparisons import EQUAL, FEWEST_SEEDS, best_or_tied, change_over_seeds
from tdgbench.tables.equal_data import changed_scores
from tdgbench.tables.likeness import SELECTED, is_selected, was_disturbed
from tdgbench.tables.measures import HOURS, measure_of
from tdgbench.tables.verdicts import BETTER, UNDECIDED, WORSE
from tdgbench.text import as_typed, named

METRIC = "psnr"  # that ranks are of
WITHOUT_WORDS = ("scene's files", "ground truth", "views", "masked")  # whose values tell a reader nothing
WITHOUT_MEAN = "its PSNR is n/a"
FEW_SEEDS = f"fewer than {FEWEST_SEEDS} seeds, or no rival with as many"


def ranked(rows: Iterable[BoardRow]) -> list[BoardRow]:
    """Return the rows of all packs with ranks and bold type among their rivals.

    Rivals have one data set, protocol, budget and scene; averages are over the same scenes. Ranks reach from one more
    than the number of rivals that are better in PSNR (`change_over_seeds`) to that of all that are not worse. A row
    whose cells another pack holds as well counts once, whatever metrics of its own that pack has, and however its
    options were given.
    """
    groups: dict[tuple[str, ...], list[BoardRow]] = {}
    for row in rows:
        groups.setdefault((row.dataset, row.protocol, row.training, row.scene, *row.scenes), []).append(row)
    return [row for rivals in groups.values() for row in _ranked(rivals)]


def _ranked(rows: list[BoardRow]) -> list[BoardRow]:
    """Rank rivals; one that holds the cells of another pack has its rank, one that holds some of them has none.

    None is ranked where equal renders have unlike scores: somebody changed a record.
    """
    if why := _changed_in_words(rows):
        return [replace(row, unranked=why, is_unlike=True) for row in rows]
    by_content: dict[tuple[object, ...], list[BoardRow]] = {}
    for row in rows:
        same: tuple[object, ...] = *row.started, row.content or row.pack.page  # however its options were given
        if any(one.pack is row.pack for one in by_content.get(same, [])):
            same = *same, row.column
        by_content.setdefault(same, []).append(row)
    wholes = [next((row for row in rows if _is_part(first, row)), None) for first, *_ in by_content.values()]
    rivals = [first for (first, *_), whole in zip(by_content.values(), wholes, strict=True) if whole is None]
    of_rivals, found = iter(_among_rivals(rivals)), list[BoardRow]()
    for twins, whole in zip(by_content.values(), wholes, strict=True):
        if whole is None:
            one, *twins = next(of_rivals), *twins[1:]
            found.append(one)
            why = f"same cells as {one.pack.name}, ranked once"
        else:
            why = f"its models and renders equal some of {whole.pack.name}"
            one = replace(twins[0], unranked=why)
        ranks = {name: getattr(one, name) for name in ("ranks", "rivals", "tied", "unranked", "is_unlike")}
        for row in twins:
            is_bold = [own.bold and own.value == cell.value for own, cell in zip(one.scores, row.scores, strict=True)]
            scores = [cell._replace(bold=bold) for cell, bold in zip(row.scores, is_bold, strict=True)]
            found.append(replace(row, **ranks, scores=tuple(scores), twin=why))
    return found


def _changed_in_words(rows: Iterable[BoardRow]) -> str:
    """Return which scores of equal renders are unlike, and whose, in words; empty if none are."""
    known = list(rows)
    of_content = changed_scores(record for row in known for record in row.records)
    found = [
        (name, row.label) for row in known for one in row.records for name in of_content.get(shared_content(one), ())
    ]
    labels, who = (
        named(dict.fromkeys(words)) for words in ([measure_of(n).label for n, _ in found], [w for _, w in found])
    )
    return f"equal renders of {who} have unlike {labels}, so a record was changed: verify the packs" if found else ""


def _is_part(row: BoardRow, whole: BoardRow) -> bool:
    """Return whether another pack's row has all cells of a row, and more."""
    is_other = row.pack is not whole.pack and row.started == whole.started
    return is_other and bool(row.content) and row.content < whole.content


def _among_rivals(rivals: list[BoardRow]) -> list[BoardRow]:
    if len(rivals) < 2:
        return rivals
    if any(row.setups != rivals[0].setups or len(row.setups) > len(row.scenes) for row in rivals):
        unlike = (
            f"the rows of all packs differ in {_differences(rivals)}. Only like trainings on equal images are ranked"
        )
        return [replace(row, unranked=unlike, is_unlike=True) for row in rivals]
    known = [not np.isnan(row.scores[SCORES.index(METRIC)].value) for row in rivals]
    reasons = [
        SELECTED if any(map(is_selected, row.records)) else "" if is_known else WITHOUT_MEAN
        for row, is_known in zip(rivals, known, strict=True)
    ]
    found = [replace(row, unranked=why or FEW_SEEDS) for row, why in zip(rivals, reasons, strict=True)]
    able = [i for i, row in enumerate(rivals) if not reasons[i] and len(row.by_seed(METRIC)) >= FEWEST_SEEDS]
    if len(able) < 2:
        return found
    numbers = _by_seed(METRIC, [rivals[i] for i in able])
    marks = np.array([_bold(metric, [rivals[i] for i in able]) for metric in SCORES])
    several = len({row.pack.page for row in rivals}) > 1
    names = [rivals[i].label + f" ({rivals[i].pack.name})" * several for i in able]
    for nth, i in enumerate(able):
        verdicts = [change_over_seeds(METRIC, other, numbers[nth]).verdict for other in np.delete(numbers, nth, axis=0)]
        others = [name for other, name in enumerate(names) if other != nth]
        tied = tuple(name for name, verdict in zip(others, verdicts, strict=True) if verdict in (EQUAL, UNDECIDED))
        scores = [cell._replace(bold=bool(bold)) for cell, bold in zip(found[i].scores, marks[:, nth], strict=True)]
        ranks = 1 + verdicts.count(BETTER), len(able) - verdicts.count(WORSE)
        found[i] = replace(found[i], ranks=ranks, rivals=len(able), tied=tied, scores=tuple(scores))
    return found


def _differences(rows: Sequence[BoardRow]) -> str:
    """Return in what rows that are not alike differ, with the values that tell a reader something."""
    if rows[0].is_average:
        return "their trainings or images of a scene"
    setups = [json.loads(text) for row in rows for text in sorted(row.setups)]
    if any("skip.otherwise" in one for one in setups):
        setups = [_with_skips_in_words(one) for one in setups]
    found = differences([{name: as_typed(value) for name, value in one.items()} for one in setups], as_typed(None))
    texts = {name: f"{name}: {' or '.join(dict.fromkeys(values))}" for name, values in found.items()}
    return "; ".join(name if name in WITHOUT_WORDS else text for name, text in texts.items())


def _with_skips_in_words(setup: dict[str, object]) -> dict[str, object]:
    """Return a setup with its skips in one value: it may state those alone that are not `otherwise`."""
    options = {name.removeprefix("skip."): value for name, value in setup.items() if name.startswith("skip.")}
    otherwise = options.pop("otherwise", True) is not False
    changed = [name for name, value in options.items() if value is not None and value != otherwise]
    words = "default" if otherwise else "none (all off)"
    rest = {name: value for name, value in setup.items() if not name.startswith("skip.")}
    return {**rest, "skip": " but ".join([words, *([", ".join(changed)] if changed else [])])}


def _bold(metric: str, rows: Sequence[BoardRow]) -> list[bool]:
    """Return which rows are the best in a metric, or cannot be told from it; none in times that do not compare."""
    if metric == HOURS.name and (len(set().union(*(row.machines for row in rows))) > 1 or any(map(is_disturbed, rows))):
        return [False] * len(rows)
    values = [row.scores[SCORES.index(metric)].value for row in rows]
    return best_or_tied(metric, np.array(values, dtype=float), _by_seed(metric, rows)).tolist()


def is_disturbed(row: BoardRow) -> bool:
    """Return whether a row's times are of a busy machine."""
    return any(map(was_disturbed, row.records))


def _by_seed(metric: str, rows: Sequence[BoardRow]) -> np.ndarray:
    """Return the rows' numbers by seed (rows, seeds), NaN where a row lacks the seed."""
    found = [row.by_seed(metric) for row in rows]
    seeds = sorted(set().union(*found))
    return np.array([[of_row.get(seed, np.nan) for seed in seeds] for of_row in found], dtype=float)
