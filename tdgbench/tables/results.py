"""Records as a long table: one row per method, scene and metric; what is not there is n/a with its reason."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from tdgbench.bench.plan import Plan
from tdgbench.bench.record import Record
from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.scoring import METRICS as SCORES

METRICS = ("psnr", "ssim", "lpips", "hours")  # of the published tables
TRAIN_METRICS = ("train_psnr", "train_ssim")  # of the training views: what overfits is far better there
EXTRA_METRICS = (*(m for m in SCORES if m not in METRICS), *TRAIN_METRICS)
HIGHER_IS_BETTER = {m: m.endswith(("psnr", "ssim")) for m in (*METRICS, *EXTRA_METRICS)}
DECIMALS = {m: 2 if m.endswith("psnr") else 3 for m in (*METRICS, *EXTRA_METRICS)}
KEYS = ["method", "dataset", "group", "scene", "metric"]
AVERAGE, OVERALL = "Average", "Average (Overall)"
METHOD_ORDER = ("msmg", "tdg")
SPLITS = {
    "eighty_twenty": "every 5th view is tested, 80/20 as the paper says",
    "every_8th": "every 8th view is tested",
    "folder": "the shipped train/ and test/ folders, as both releases read them",
}
NO_RECORD = "not run, or the scene is not on disk"


def method_label(record: Record, with_init: bool) -> str:
    """The method as a column: other overrides, and inits other than COLMAP, set columns apart."""
    label = record.method
    if with_init and record.init != "colmap":
        label += f" ({record.init})"
    return label + (f" [{record.variant}]" if record.variant else "")


def metric_value(record: Record, metric: str) -> tuple[float, str]:
    """The value (NaN for n/a) and the reason if there is none."""
    if record.failure is not None:
        return np.nan, f"failed in {record.failure.stage}: {record.failure.error.splitlines()[0]}"
    if metric == "hours":
        return record.seconds["train"] / 3600, ""
    if metric in TRAIN_METRICS:
        value = record.train_scores.get(metric.removeprefix("train_"))
    else:
        value = record.scores.get(metric)
    return (np.nan, record.missing.get(metric, "not scored")) if value is None else (value, "")


def scene_rows(records: Iterable[Record], plan: Plan, init: str | None = None) -> pd.DataFrame:
    """Rows (KEYS, value, reason) of every method × scene × metric, mean over seeds; n/a rows where nothing is known.

    With `init` only its records count, and inits do not make columns.
    """
    chosen = [r for r in records if init in (None, r.init)]
    labels = [method_label(r, with_init=init is None) for r in chosen]
    scenes = _scenes(chosen, plan)
    of_paper = any(s["dataset"] in DATASETS.values() for s in scenes)
    wanted = {*plan.methods, *(METHOD_ORDER if of_paper else ())} - {label.split(" ")[0] for label in labels}
    methods = sorted({*labels, *wanted}, key=_method_rank)
    rows = []
    for method in methods:
        for scene in scenes:
            own = [
                r
                for r, label in zip(chosen, labels, strict=True)
                if label == method and (r.dataset, r.scene) == (scene["dataset"], scene["scene"])
            ]
            for metric in (*METRICS, *EXTRA_METRICS):
                pairs = [metric_value(r, metric) for r in own] or [(np.nan, NO_RECORD)]
                value = float(np.mean([v for v, _ in pairs]))  # NaN if any seed lacks it
                reason = next((reason for _, reason in pairs if reason), "")
                rows.append({"method": method, **scene, "metric": metric, "value": value, "reason": reason})
    return pd.DataFrame(rows, columns=[*KEYS, "value", "reason"])


def with_splits(rows: pd.DataFrame, records: Iterable[Record]) -> pd.DataFrame:
    """The rows with `split`: how the views of their cells were split (`a + b` for an average over both)."""
    splits: dict[str, dict[tuple[str, str], set[str]]] = {}
    for record in records:
        of_method = splits.setdefault(method_label(record, with_init=True), {})
        of_method.setdefault((record.dataset, record.scene), set()).add(record.split)

    def split_of(method: str, dataset: str, scene: str) -> str:
        own = splits.get(method, {})
        if scene not in (AVERAGE, OVERALL):
            return " + ".join(sorted(own.get((dataset, scene), set())))
        return " + ".join(sorted({s for (d, _), found in own.items() if dataset in ("", d) for s in found}))

    found = [split_of(r.method, r.dataset, r.scene) for r in rows.itertuples()]
    return rows.assign(split=found)


def split_notes(main: pd.DataFrame) -> list[str]:
    """Which views were tested, in words, one line for each split in a main table."""
    return [f"split {name}: {SPLITS.get(name, name)}" for name in dict.fromkeys(main["split"]) if name in SPLITS]


def with_averages(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows and their averages per data set and overall; an average over anything missing is n/a."""
    parts = []
    datasets = list(dict.fromkeys(rows["dataset"]))
    for method, of_method in rows.groupby("method", sort=False):
        for dataset in datasets:
            own = of_method[of_method["dataset"] == dataset]
            parts += [own, _average(own, str(method), dataset, AVERAGE)]
        if len(datasets) > 1:
            parts.append(_average(of_method, str(method), "", OVERALL))
    return pd.concat(parts, ignore_index=True) if parts else rows


def with_bold(rows: pd.DataFrame) -> pd.DataFrame:
    """Mark the best method of each row of the table; values that print the same are a tie, and nobody is marked."""
    rows = rows.copy()
    rounded = [
        np.nan if np.isnan(v) else round(v, decimals(metric, scene))
        for v, metric, scene in zip(rows["value"], rows["metric"], rows["scene"], strict=True)
    ]
    rows["bold"] = False
    for (_, _, metric), group in pd.Series(rounded, rows.index).groupby(
        [rows["dataset"], rows["scene"], rows["metric"]], sort=False
    ):
        known = group.dropna()
        best = known.max() if HIGHER_IS_BETTER[str(metric)] else known.min()
        winners = known.index[known == best]
        if len(known) > 1 and len(winners) == 1:
            rows.loc[winners, "bold"] = True
    return rows[[*KEYS, "value", "bold", *(["reason"] if "reason" in rows else [])]]


def first_points(ablation: pd.DataFrame) -> list[str]:
    """How the first points of each init of an ablation were made, in words, where it is known."""
    hows = ablation.groupby("init", sort=False)["points"].first()
    return [f"{init}: {how}" for init, how in hows.items() if how]


def decimals(metric: str, scene: str) -> int:
    """Digits after the point, as the paper prints them (its overall SSIM has four)."""
    return 4 if metric.endswith("ssim") and scene == OVERALL else DECIMALS[metric]


def _average(rows: pd.DataFrame, method: str, dataset: str, name: str) -> pd.DataFrame:
    result = []
    for metric, own in rows.groupby("metric", sort=False):
        lacking = int(own["value"].isna().sum())
        reasons = set(own["reason"]) - {""}
        why = reasons.pop() if len(reasons) == 1 else f"{lacking} of {len(own)} scenes are n/a"
        result.append(
            {
                "method": method,
                "dataset": dataset,
                "group": "",
                "scene": name,
                "metric": metric,
                "value": float(own["value"].mean(skipna=False)),
                "reason": why if lacking else "",
            }
        )
    return pd.DataFrame(result)


def _scenes(records: list[Record], plan: Plan) -> list[dict[str, str]]:
    """The scenes of the table: planned, seen in records, and if any is of the paper, all of the paper's."""
    keys = {(s["dataset"], s["scene"]): s for s in plan.scenes}
    for r in records:
        keys.setdefault((r.dataset, r.scene), {"scene": r.scene, "dataset": r.dataset, "group": r.group})
    paper = {
        (DATASETS[s.dataset], s.name): {"scene": s.name, "dataset": DATASETS[s.dataset], "group": s.group}
        for s in SCENES
    }
    if any(key in paper for key in keys):
        keys = {**paper, **{k: v for k, v in keys.items() if k not in paper}}
    return list(keys.values())


def _method_rank(label: str) -> tuple[int, str]:
    name = label.split(" ")[0]
    return (METHOD_ORDER.index(name) if name in METHOD_ORDER else len(METHOD_ORDER), label)
