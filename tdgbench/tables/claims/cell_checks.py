"""Checks that compare trained cells pair by pair. Where the paper prints no such number, only our results decide.

Each gain has its 95 % interval (`pairs.gain_interval`) and is judged against the claim's margin (`pairs.judge_gain`),
by the longest trainings of two methods (`evidence.decisive`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from tdgbench.cells.renders import budget_of
from tdgbench.tables import methods
from tdgbench.tables.claims import table_checks
from tdgbench.tables.claims.cell_pairs import (
    CellPair,
    Interval,
    Side,
    all_of,
    counts_in_words,
    gain_interval,
    judge_gain,
    make_pairs,
    place_of,
)
from tdgbench.tables.claims.evidence import (
    HOLDS,
    UNDECIDED,
    Claim,
    ClaimEvidence,
    Finding,
    MissingError,
    decisive,
    on_built_in,
)
from tdgbench.tables.claims.quantities import QUANTITIES, Quantity
from tdgbench.tables.likeness import was_disturbed
from tdgbench.tables.long_table import is_random, iterations_in_words
from tdgbench.tables.results import Cell
from tdgbench.tables.statistics import with_interval
from tdgbench.text import named

COLMAP: Final = "colmap"


def better(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that each of `methods` is better than each of `against` at the most equal iterations, from COLMAP points.

    margins: the least gain in each quantity: a difference in its unit, or a share where two cells are compared by
    their ratio (0.1: 10 % less). stages: see `Claim`. A claim holds only if all combinations have pairs.
    """
    sides = [(Side(a, COLMAP), Side(b, COLMAP)) for a in claim.methods for b in claim.against if a != b]
    return _compare(claim, evidence, sides)


def better_at_equal_size(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check as `better` by cells that have the number of Gaussians that was asked for, of those that render thermal."""
    if not evidence.printed and not evidence.equal_sized:
        raise MissingError("no cells of ours at equal numbers of Gaussians (+experiment=capacity)")
    return better(claim, replace(evidence, cells=evidence.equal_sized))


def better_average(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method beats its baseline in the mean of each of `metrics`, as printed or over cells."""
    if evidence.printed:
        return table_checks.average_gains(claim, evidence)
    _need_cells(claim, evidence)
    chosen, left_out = evidence.published_pairs
    pairs = [CellPair(*pair) for pair in chosen]
    parts = {metric: _gain(claim, QUANTITIES[metric], 0.0, pairs) for metric in claim.metrics}
    findings = [part for found in parts.values() for part in found]
    if not findings:
        raise MissingError(f"no pair of {named(map(methods.label, methods.paper_pair()))}")
    missing = [QUANTITIES[metric].label for metric, found in parts.items() if not found]
    return _with_notes(_whole(all_of(findings), missing), [left_out], pairs)


def better_init(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that for each of `methods` the points named by `better` (colmap or random) beat the others.

    Each kind of random points is judged separately. margins: as in `better`.
    """
    _need_cells(claim, evidence)
    inits = dict.fromkeys(c.record.init for c in evidence.cells if is_random(c.record.init))
    if not inits:
        raise MissingError("no cells from random points")
    sides = [(Side(method, COLMAP), Side(method, init)) for method in claim.methods for init in inits]
    if claim.better != COLMAP:
        sides = [(other, mine) for mine, other in sides]
    return _compare(claim, evidence, sides)


def random_fails(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that all `methods` lose at least `drop` dB of PSNR from random points: as printed, or pair by pair."""
    if evidence.printed:
        return table_checks.ablation_drop(claim, evidence)
    return better_init(replace(claim, better=COLMAP, margins={"psnr": claim.drop}), evidence)


def attributed(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that depth explains more than `share` of the time that TDg saves, of log(time of MSMG / time of TDg).

    A chain of changes leads from MSMG at its longest to TDg at its shortest, and their logarithms add up: fewer
    iterations (MSMG at TDg's length), no RGB model (3dgs_smooth, which also weighs its loss by 1 and uses the
    smoothness of eq. 6), depth (TDg).
    """
    _need_cells(claim, evidence)
    links = _links(evidence)
    if not links:
        raise MissingError("no cells of tdg, 3dgs_smooth (TDg without depth) and msmg on one machine")
    links, left_out = decisive(links)
    places = [place_of(cells[0]) for cells in links]
    logs = np.log([[cell.record.seconds["train"] for cell in cells] for cells in links])
    steps = logs[:, :-1] - logs[:, 1:]
    total = gain_interval(places, steps.sum(axis=1))
    lengths = " and ".join(dict.fromkeys(str(links[0][end].planned_iterations) for end in (-1, 0)))
    times = f"time TDg / MSMG at {lengths} {_ratio_text(total)}, {counts_in_words(total)}"
    all_cells = [cell for cells in links for cell in cells]
    if not total.low > 0:
        found = Finding(UNDECIDED, f"no sure speed-up to attribute: {times}")
        return _with_notes(found, [left_out], [all_cells])
    named = zip(("fewer iterations", "no RGB model", "depth"), steps.T, strict=True)
    shares = [
        f"{name} {100 * gain_interval(places, link).mean / total.mean:.0f} %" for name, link in named if link.any()
    ]
    depth = gain_interval(places, steps[:, 2])
    grounds = f"{times}; of its logarithm {', '.join(shares)}; depth alone multiplies time by {_ratio_text(depth)}"
    verdict = judge_gain(gain_interval(places, steps[:, 2] - claim.share * steps.sum(axis=1)), 0.0)
    return _with_notes(Finding(verdict, grounds), [left_out], [all_cells])


def _need_cells(claim: Claim, evidence: ClaimEvidence) -> None:
    """Raise MissingError without cells."""
    if evidence.printed:
        raise MissingError(f"the paper prints no {claim.unprinted or 'such number'}")
    if not evidence.cells:
        raise MissingError("no cells of ours")


def _compare(claim: Claim, evidence: ClaimEvidence, sides: Sequence[tuple[Side, Side]]) -> Finding:
    _need_cells(claim, evidence)
    counts_gaussians = any(QUANTITIES[name].counts_gaussians for name in claim.margins)
    findings: list[Finding] = []
    judged: list[CellPair] = []
    notes: list[str] = []
    missing: list[str] = []
    for mine, other in sides:
        pairs = make_pairs(evidence, mine, other, claim.stages)
        grown = [pair for pair in pairs if not counts_gaussians or all(map(_has_density_control, pair))]
        chosen, left_out = decisive(grown)
        by_name = {name: _gain(claim, QUANTITIES[name], margin, chosen) for name, margin in claim.margins.items()}
        kinds = {QUANTITIES[name].kind or name for name, found in by_name.items() if found}
        without = [QUANTITIES[name].label for name in by_name if (QUANTITIES[name].kind or name) not in kinds]
        names = f"{_name(mine, other)} with {_name(other, mine)}"
        missing += [f"{', '.join(without)} of {names}" if kinds else names] if without else []
        if kinds:
            findings, judged = [*findings, *chain.from_iterable(by_name.values())], judged + chosen
            notes.append(left_out)
        if len(grown) < len(pairs):
            notes.append("left out: trainings that ended before density control began")
    if not findings:
        sought = " or ".join(dict.fromkeys(f"{_name(a, b)} and {_name(b, a)}" for a, b in sides))
        nothing = f"no pair of {sought} with {', '.join(QUANTITIES[name].label for name in claim.margins)}"
        raise MissingError("; ".join([nothing, *dict.fromkeys(filter(None, notes))]))
    return _with_notes(_whole(all_of(findings), missing), [*notes, claim.note], judged)


def _whole(finding: Finding, missing: Sequence[str]) -> Finding:
    """Return the finding on a claim, some parts of which may have no pairs: then it does not hold, but may fail."""
    if not missing:
        return finding
    grounds = f"{finding.grounds}; not compared: {'; '.join(dict.fromkeys(missing))}"
    return Finding(UNDECIDED if finding.verdict == HOLDS else finding.verdict, grounds)


def _with_notes(finding: Finding, notes: Iterable[str], compared: Iterable[Iterable[Cell]]) -> Finding:
    """Return the finding on compared cells with notes behind it, each once."""
    grounds = "; ".join(filter(None, dict.fromkeys([finding.grounds, *notes])))
    return on_built_in(Finding(finding.verdict, grounds), [cell for cells in compared for cell in cells])


def _has_density_control(cell: Cell) -> bool:
    """Return whether a training was long enough for a round of density control; True where its rules are not known."""
    try:
        rules = budget_of(cell.record).density
    except ValueError:
        return True
    length = cell.planned_iterations
    return any(rules.is_round(iteration, length) for iteration in range(rules.every, length + 1, rules.every))


def _gain(claim: Claim, quantity: Quantity, margin: float, pairs: Sequence[CellPair]) -> list[Finding]:
    """Return the finding on one quantity of pairs with equal iterations; none where no pair has it."""
    both = _pairs_with(quantity, pairs, claim)
    if not both:
        return []
    places, numbers = [place_of(pair.mine) for pair, _ in both], [found for _, found in both]
    gain = gain_interval(places, [quantity.gain(mine, other) for mine, other in numbers])
    cells = both[0][0]
    mine, other = (Side(cell.record.method, cell.record.init) for cell in cells)
    names = f"{_name(mine, other)} {'/' if quantity.ratio else '−'} {_name(other, mine)}"
    sides = zip(*(pair for pair, _ in both), strict=True)
    lengths = " and ".join(dict.fromkeys(iterations_in_words([cell.record for cell in side]) for side in sides))
    value = _ratio_text(gain) if quantity.ratio else _difference_text(gain, quantity)
    machines = len({pair.mine.machine for pair, _ in both}) if quantity.timed else 1
    several = f" in {machines} settings of processor, threads and cells at once" if machines > 1 else ""
    grounds = f"{quantity.label}, {names} at {lengths}: {value}, {counts_in_words(gain)}{several}"
    least = quantity.least_gain(margin)
    verdict, by = judge_gain(gain, least), f"{100 * margin:g} %" if quantity.ratio else f"{margin:g}{quantity.unit}"
    if verdict == UNDECIDED and 0 < gain.low <= least:
        grounds += f": better, undecided whether by the {by} that the claim needs"
    elif margin:
        grounds += f"; tested: better by more than {by}"
    return [Finding(verdict, grounds)]


def _pairs_with(
    quantity: Quantity, pairs: Sequence[CellPair], claim: Claim
) -> list[tuple[CellPair, tuple[float, float]]]:
    """Return the pairs that have a quantity, with its numbers: times of one free machine, ratios of numbers above 0."""
    if quantity.timed:
        pairs = [pair for pair in pairs if _is_on_one_free_machine(pair)]
    both = [(pair, found) for pair in pairs if (found := quantity.numbers(*pair, claim)) is not None]
    return [(pair, found) for pair, found in both if not quantity.ratio or min(found) > 0]


def _is_on_one_free_machine(cells: Sequence[Cell]) -> bool:
    return len({cell.machine for cell in cells}) == 1 and not any(was_disturbed(cell.record) for cell in cells)


def _name(side: Side, other: Side) -> str:
    """Return the method; where both sides are one method, with its initial points."""
    label = methods.label(side.method)
    return label if side.method != other.method else f"{label} from {side.init}"


def _ratio_text(gain: Interval) -> str:
    return with_interval(f"{np.exp(-gain.mean):.2f}", np.exp(-gain.high), np.exp(-gain.low), ".2f")


def _difference_text(gain: Interval, quantity: Quantity) -> str:
    """Return mine − other, whatever sign is a gain."""
    mean, *ends = (quantity.sign * value for value in gain[:3])
    low, high = ends if quantity.higher else reversed(ends)
    form = f"+.{quantity.digits}f"
    return with_interval(f"{mean:{form}}{quantity.unit}", low, high, form)


def _links(evidence: ClaimEvidence) -> list[tuple[Cell, Cell, Cell, Cell]]:
    """Return the cells of the chain from MSMG to TDg, for each setup, seed and machine."""
    times: dict[tuple[str, int, tuple[str, ...]], dict[str, dict[int, Cell]]] = {}
    longest = {setup: length for (method, setup), length in evidence.published_lengths.items() if method == "msmg"}
    for setup, cell in evidence.placed:
        if cell.record.init == COLMAP and cell.record.seconds.get("train") and not was_disturbed(cell.record):
            of_method = times.setdefault((setup, cell.record.seed, cell.machine), {})
            of_method.setdefault(cell.record.method, {}).setdefault(cell.planned_iterations, cell)
    links = []
    for (setup, _, _), by_method in times.items():
        tdg, smooth, msmg = (by_method.get(method, {}) for method in ("tdg", "3dgs_smooth", "msmg"))
        equal = tdg.keys() & smooth.keys() & msmg.keys()
        if not equal or min(equal) != min(tdg) or longest[setup] not in msmg:
            continue
        length = min(equal)
        links.append((msmg[longest[setup]], msmg[length], smooth[length], tdg[length]))
    return links
