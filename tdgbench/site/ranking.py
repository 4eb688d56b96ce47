"""Ranks and bold type across packs: one ranking a scene, protocol and budget, of rows of the same images."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tdgbench.site.packed import SCORES, BoardRow
from tdgbench.tables.comparisons import change_over_seeds, told_apart
from tdgbench.tables.measures import HOURS
from tdgbench.tables.verdicts import BETTER, WORSE

METRIC = "psnr"  # that ranks are of
FEWEST_SEEDS = 2
UNLIKE = "unlike trainings, images, views or ranges"
FEW_SEEDS = "one seed, or no rival with two"


def ranked(rows: Iterable[BoardRow]) -> list[BoardRow]:
    """Return the rows of all packs with ranks and bold type among their rivals.

    Rivals have one data set, protocol, budget and scene; averages are over the same scenes. Ranks reach from one more
    than the number of rivals that are better in PSNR (`change_over_seeds`) to that of all that are not worse. A row
    whose cells another pack holds as well counts once.
    """
    groups: dict[tuple[str, ...], list[BoardRow]] = {}
    for row in rows:
        groups.setdefault((row.dataset, row.protocol, row.training, row.scene, *row.scenes), []).append(row)
    return [row for rivals in groups.values() for row in _ranked(rivals)]


def _ranked(rows: list[BoardRow]) -> list[BoardRow]:
    """Rank rivals; one that holds the cells of another pack has its rank."""
    by_content: dict[object, list[BoardRow]] = {}
    for row in rows:
        by_content.setdefault((row.column, row.content or row.pack.page), []).append(row)
    found = []
    for one, twins in zip(
        _among_rivals([first for first, *_ in by_content.values()]), by_content.values(), strict=True
    ):
        found.append(one)
        found += [replace(one, pack=row.pack, cells=row.cells, twin=one.pack.name) for row in twins[1:]]
    return found


def _among_rivals(rivals: list[BoardRow]) -> list[BoardRow]:
    if len(rivals) < 2:
        return rivals
    if any(row.setups != rivals[0].setups or len(row.setups) > len(row.scenes) for row in rivals):
        return [replace(row, unranked=UNLIKE) for row in rivals]
    able = [i for i, row in enumerate(rivals) if len(row.by_seed(METRIC)) >= FEWEST_SEEDS]
    found = [replace(row, unranked=FEW_SEEDS) for row in rivals]
    if len(able) < 2:
        return found
    numbers = _by_seed(METRIC, [rivals[i] for i in able])
    marks = np.array([_bold(metric, [rivals[i] for i in able]) for metric in SCORES])
    for nth, i in enumerate(able):
        verdicts = [change_over_seeds(METRIC, other, numbers[nth]).verdict for other in np.delete(numbers, nth, axis=0)]
        scores = [cell._replace(bold=bool(bold)) for cell, bold in zip(found[i].scores, marks[:, nth], strict=True)]
        ranks = 1 + verdicts.count(BETTER), len(able) - verdicts.count(WORSE)
        found[i] = replace(found[i], ranks=ranks, scores=tuple(scores))
    return found


def _bold(metric: str, rows: Sequence[BoardRow]) -> list[bool]:
    """Return which of the rows are the best in a metric, or cannot be told from it; none in times of two machines."""
    if metric == HOURS.name and len(set().union(*(row.machines for row in rows))) > 1:
        return [False] * len(rows)
    values = [row.scores[SCORES.index(metric)].value for row in rows]
    return told_apart(metric, np.array(values, dtype=float), _by_seed(metric, rows)).tolist()


def _by_seed(metric: str, rows: Sequence[BoardRow]) -> np.ndarray:
    """Return the rows' numbers by seed (rows, seeds), NaN where a row lacks the seed."""
    found = [row.by_seed(metric) for row in rows]
    seeds = sorted(set().union(*found))
    return np.array([[of_row.get(seed, np.nan) for seed in seeds] for of_row in found], dtype=float)
