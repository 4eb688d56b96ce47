"""Claims of papers in words, each checked against the published tables and against our results.

A claim `holds`, `fails`, or is `undecided` where the evidence lacks its numbers or does not settle it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
from omegaconf import OmegaConf

from tdgbench.tables.between_papers import gain_against_spread
from tdgbench.tables.claims import cells, main_table
from tdgbench.tables.claims.evidence import UNDECIDED, Claim, ClaimEvidence, Finding, MissingError
from tdgbench.tables.claims.quantities import QUANTITIES
from tdgbench.tables.published import FOLDER

THE_PAPER = "TDg"  # of claims that name none
Check = Callable[[Claim, ClaimEvidence], Finding]
OF_TABLES: tuple[Check, ...] = (
    main_table.relative_gain,
    main_table.averages,
    main_table.better_mostly,
    main_table.better_scenes,
    main_table.mixed,
    main_table.minutes_saved,
    main_table.within,
    main_table.ablation_agrees,
    main_table.averages_follow,
    main_table.bold_follows,
)
OF_CELLS: tuple[Check, ...] = (
    cells.better,
    cells.better_average,
    cells.better_init,
    cells.random_fails,
    cells.attributed,
)
CHECKS: dict[str, Check] = {check.__name__: check for check in (*OF_TABLES, *OF_CELLS)}  # type: ignore[attr-defined]


def load_claims(path: Path = FOLDER / "claims.yaml") -> list[Claim]:
    """Load the claims. Raises ValueError for one without id, words, a known check, known quantities or their reason."""
    claims: list[Claim] = OmegaConf.to_container(OmegaConf.load(path))  # type: ignore[assignment]
    for claim in claims:
        needed = {"id", "said", "where", "check", *(["reason"] if "margins" in claim else [])}
        faults = [f"lacks {key}" for key in sorted(needed - set(claim))]
        names = {claim.get("check"), *claim.get("margins", {})} - {None, *CHECKS, *QUANTITIES}
        faults += [f"names {name!r}, which is no check or quantity" for name in sorted(names)]
        if faults:
            raise ValueError(f"{path}: claim {claim.get('id', '?')} {' and '.join(faults)}")
    return claims


def check_claim(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check one claim. With `gain`, the average gain is compared with the spread between papers."""
    check = CHECKS[claim["check"]]
    try:
        finding = check(claim, evidence)
    except MissingError as error:
        return Finding(UNDECIDED, str(error))
    parts = [finding.grounds]
    if check in OF_TABLES:
        parts.append(evidence.note)
    if "gain" in claim:
        metrics = claim["metrics"] if "metrics" in claim else [claim["metric"]]
        parts.append(gain_against_spread(evidence.main, metrics))
    return Finding(finding.verdict, "; ".join(part for part in parts if part))


def check_all(claims: list[Claim], published: ClaimEvidence, ours: ClaimEvidence | None) -> pd.DataFrame:
    """Return one row per claim: id, said, where, paper, and for the published table and ours verdict and grounds."""
    rows = []
    for claim in claims:
        row = {key: claim[key] for key in ("id", "said", "where")} | {"paper": claim.get("paper", THE_PAPER)}
        for side, evidence in (("published", published), ("ours", ours)):
            finding = Finding(UNDECIDED, "no results") if evidence is None else check_claim(claim, evidence)
            row |= {side: finding.verdict, f"{side}_seen": finding.grounds}
        rows.append(row)
    return pd.DataFrame(rows)
