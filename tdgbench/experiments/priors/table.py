"""The experiment's tables: a row per scene and prior, and the error of each prior in each view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from tdgbench.bench.record import Record
from tdgbench.experiments.priors.judge import Judged
from tdgbench.tables.latex import comment, escape

NONE = "none"  # TDg without its depth loss
SCORES = ("psnr", "ssim", "lpips", "depth_abs_rel")
COLUMNS = {  # those of LaTeX: title, format
    "scene": ("scene", ""), "prior": ("prior", ""), "made_from": ("made from", ""), "abs_rel": ("AbsRel", ".3f"),
    "delta": ("δ<1.25", ".3f"), "rank": ("rank", ".2f"), "psnr": ("PSNR", ".2f"), "psnr_gain": ("gain", "+.2f"),
    "ssim": ("SSIM", ".3f"), "lpips": ("LPIPS", ".3f"),
}  # fmt: skip


class Entry(NamedTuple):
    """A prior on a scene: how it was judged, and the records of TDg's finished cells with it, one per seed."""

    scene: str
    prior: str
    made_from: str
    truth: str
    judged: Judged
    records: Sequence[Record]
    reason: str = ""  # why a number is missing


def prior_rows(entries: Sequence[Entry]) -> pd.DataFrame:
    """One row per scene and prior. Errors are means over the training views, scores means over the seeds.

    psnr_gain: PSNR minus that without a prior, mean over the seeds that both have. reason: why numbers are missing.
    """
    without = {(e.scene, r.seed): r.scores.get("psnr") for e in entries if e.prior == NONE for r in e.records}
    rows = []
    for entry in entries:
        found = entry.judged.mean
        gains = [
            record.scores["psnr"] - base  # type: ignore[operator]
            for record in entry.records
            if (base := without.get((entry.scene, record.seed))) is not None and entry.prior != NONE
        ]
        rows.append(
            {
                "scene": entry.scene, "prior": entry.prior, "made_from": entry.made_from, "kind": entry.judged.kind,
                "truth": entry.truth if found else "", "views": len(entry.judged.views),
                **{name: np.nan if found is None else getattr(found, name) for name in ("abs_rel", "delta", "rank")},
                "seeds": len(entry.records), **{name: _mean(entry.records, name) for name in SCORES},
                "psnr_gain": float(np.mean(gains)) if gains else np.nan, "reason": entry.judged.reason or entry.reason,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def view_rows(entries: Sequence[Entry]) -> pd.DataFrame:
    """One row per scene, prior and training view."""
    rows = [
        {"scene": entry.scene, "prior": entry.prior, "view": view, **one._asdict()}
        for entry in entries
        for view, one in entry.judged.views.items()
    ]
    return pd.DataFrame(rows, columns=["scene", "prior", "view", "abs_rel", "delta", "rank"])


def as_text(table: pd.DataFrame, without: Sequence[str] = ()) -> pd.DataFrame:
    """The columns of COLUMNS but some, as text with `n/a` for missing numbers."""
    shown = {}
    for name, (title, form) in COLUMNS.items():
        if name in without:
            continue
        shown[title] = [_text(value, form) if form else str(value) for value in table[name]]
    return pd.DataFrame(shown)


def reasons(table: pd.DataFrame) -> list[str]:
    """Why numbers are missing, one line per reason, with the places."""
    places: dict[str, list[str]] = {}
    for row in table[table["reason"] != ""].itertuples():
        places.setdefault(str(row.reason), []).append(f"{row.prior} on {row.scene}")
    return [f"{', '.join(where)}: {reason}" for reason, where in places.items()]


def latex(table: pd.DataFrame) -> str:
    """The same table as LaTeX; needs the package booktabs. Reasons of missing numbers are comments."""
    shown = as_text(table)
    titles = [r"$\delta<1.25$" if title.startswith("δ") else escape(title) for title in shown.columns]
    words = sum(not form for _, form in COLUMNS.values())
    lines = [
        *(comment(reason) for reason in reasons(table)),
        rf"\begin{{tabular}}{{{'l' * words}{'r' * (len(titles) - words)}}}",
        r"\toprule",
        f"{' & '.join(titles)} \\\\",
    ]
    for _, group in shown.groupby("scene", sort=False):
        lines += [r"\midrule", *(f"{' & '.join(map(escape, row))} \\\\" for row in group.itertuples(index=False))]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _mean(records: Sequence[Record], name: str) -> float:
    values = [record.scores.get(name) for record in records]
    return float(np.mean(values)) if values and None not in values else np.nan  # type: ignore[arg-type]


def _text(value: float, form: str) -> str:
    return "n/a" if np.isnan(value) else f"{value:{form}}"
