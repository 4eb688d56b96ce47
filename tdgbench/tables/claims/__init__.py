"""Claims of papers in words, each checked against the published tables and against our results.

A claim `holds`, `fails`, or is `undecided` where the evidence lacks its numbers or does not settle it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from omegaconf import OmegaConf
from pydantic import TypeAdapter

from tdgbench.tables import methods
from tdgbench.tables.between_papers import gain_against_spread
from tdgbench.tables.claims import cell_checks, table_checks
from tdgbench.tables.claims.evidence import (
    UNDECIDED,
    Claim,
    ClaimEvidence,
    Finding,
    JudgedClaim,
    MissingError,
    on_built_in,
)
from tdgbench.tables.claims.quantities import QUANTITIES
from tdgbench.tables.published import FOLDER, published_ablation, published_main


class Check(NamedTuple):
    """How a claim is checked. needs: fields of Claim that it reads. of_tables: on the main table, not on cells."""

    run: Callable[[Claim, ClaimEvidence], Finding]
    needs: tuple[str, ...] = ()
    of_tables: bool = True


CHECKS = {
    "relative_gain": Check(table_checks.relative_gain, ("metric", "percent")),
    "averages": Check(table_checks.averages, ("metric", "averages")),
    "better_mostly": Check(table_checks.better_mostly, ("dataset", "metrics")),
    "better_scenes": Check(table_checks.better_scenes, ("dataset", "metrics", "exceptions")),
    "mixed": Check(table_checks.mixed, ("dataset", "metrics")),
    "minutes_saved": Check(table_checks.minutes_saved, ("minutes",)),
    "within": Check(table_checks.within, ("dataset", "metric", "most")),
    "ablation_agrees": Check(table_checks.ablation_agrees, ("metrics",)),
    "averages_follow": Check(table_checks.averages_follow),
    "bold_follows": Check(table_checks.bold_follows),
    "better": Check(cell_checks.better, ("methods", "against", "margins"), of_tables=False),
    "better_at_equal_size": Check(cell_checks.better_at_equal_size, ("methods", "against", "margins"), of_tables=False),
    "better_average": Check(cell_checks.better_average, ("metrics",), of_tables=False),
    "better_init": Check(cell_checks.better_init, ("methods", "better", "margins"), of_tables=False),
    "random_fails": Check(cell_checks.random_fails, ("methods", "drop"), of_tables=False),
    "attributed": Check(cell_checks.attributed, ("share",), of_tables=False),
}


def load_claims(path: Path = FOLDER / "claims.yaml") -> list[Claim]:
    """Load the claims. Raises ValueError for one without id, words, a known check, what it reads, known quantities."""
    entries: list[dict[str, Any]] = OmegaConf.to_container(OmegaConf.load(path))  # type: ignore[assignment]
    for entry in entries:
        reads = CHECKS[entry["check"]].needs if entry.get("check") in CHECKS else ()
        needed = {"id", "said", "where", "check", *reads, *(["reason"] if "margins" in entry else [])}
        faults = [f"lacks {key}" for key in sorted(needed - set(entry))]
        names = {entry.get("check"), *entry.get("margins", {})} - {None, *CHECKS, *QUANTITIES}
        faults += [f"names {name!r}, which is no check or quantity" for name in sorted(names)]
        if faults:
            raise ValueError(f"{path}: claim {entry.get('id', '?')} {' and '.join(faults)}")
    return TypeAdapter(list[Claim]).validate_python(entries)


def check_claim(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check one claim. With `gain`, the average gain is compared with the spread between papers."""
    check = CHECKS[claim.check]
    try:
        finding = check.run(claim, evidence)
    except MissingError as error:
        return Finding(UNDECIDED, str(error))
    verdict, parts = finding.verdict, [finding.grounds]
    if check.of_tables:
        of_one_seed = evidence.is_of_one_seed
        verdict = UNDECIDED if of_one_seed else verdict
        open_ = "one seed decides nothing" if of_one_seed else "95 % intervals over seeds leave it open"
        parts += [evidence.note, open_ if verdict == UNDECIDED else ""]
    compared = {*claim.methods, *claim.against} or {*methods.paper_pair()}
    failed = {methods.label(name): count for name, count in evidence.failed.items() if name in compared}
    if failed:
        verdict = UNDECIDED
        parts.append(f"trainings failed, which this leaves out ({', '.join(f'{n} of {m}' for m, n in failed.items())})")
    if claim.gain:
        parts.append(gain_against_spread(evidence.main, claim.metrics or [claim.metric]))
    found = Finding(verdict, "; ".join(part for part in parts if part))
    return on_built_in(found, evidence.published_cells if check.of_tables else ())


def judge_claims(ours: ClaimEvidence | None, claims: Sequence[Claim] | None = None) -> list[JudgedClaim]:
    """Judge claims by the published tables and by our results. claims: None for those of `load_claims`."""
    published, judged = ClaimEvidence(published_main(), published_ablation(), printed=True), []
    for claim in load_claims() if claims is None else claims:
        by_print = check_claim(claim, published)
        by_ours = Finding(UNDECIDED, "no results") if ours is None else check_claim(claim, ours)
        judged.append(JudgedClaim(claim.id, claim.said, claim.where, claim.paper, *by_print, *by_ours))
    return judged


def claims_table(judged: Iterable[JudgedClaim]) -> pd.DataFrame:
    """Return the rows as the table that claims.csv holds."""
    return pd.DataFrame(judged, columns=list(JudgedClaim._fields))
