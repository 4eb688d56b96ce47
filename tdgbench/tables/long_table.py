"""Records as a long table: one row per method, scene and metric; missing numbers are n/a with a reason."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import partial
from operator import attrgetter

import numpy as np
import pandas as pd

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Record
from tdgbench.scenes import Description
from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.tables import methods
from tdgbench.tables.measures import AVERAGE, COLUMNS, KEYS, OVERALL, RecordMeasure, further, is_of_training, measure_of
from tdgbench.tables.palette import with_text_of_cells

SPLITS = {
    "eighty_twenty": "every 5th view is tested, 80/20 as the paper says",
    "every_8th": "every 8th view is tested",
    "folder": "the shipped train/ and test/ folders, as both releases read them",
}
RANGE = "range_degC"  # column of main.csv
ABOUT = ("split", "protocol", "iterations", "prior", "lpips_net", RANGE)  # columns of main.csv on the cells of a row
NO_RECORD = "no cell here: not run or scored, or the scene is not on disk"


def method_label(record: Record, with_init: bool) -> str:
    """Return the method's column. Inits other than COLMAP (if `with_init`) and other overrides get separate columns.

    >>> method_label(Record("tdg", "synthetic", "orbit", "random", 0, "demo", "budget=short"), with_init=True)
    'tdg (random) [budget=short]'
    """
    label = record.method
    if with_init and record.init != "colmap":
        label += f" ({record.init})"
    return label + (f" [{record.variant}]" if record.variant else "")


def is_random(init: str) -> bool:
    """Return whether initial points of this name are random ones, of whatever kind.

    >>> is_random("random_box"), is_random("mvs_thermal")
    (True, False)
    """
    return init == "random" or init.startswith("random_")


def metric_value(record: Record, metric: str) -> tuple[float, str]:
    """Return the value (NaN for n/a), and the reason for n/a."""
    if record.failure is not None:
        return np.nan, record.why_failed
    described = measure_of(metric)
    if isinstance(described, RecordMeasure):
        number = described.of_record(record)
        return number, record.missing.get(metric, "not recorded" if np.isnan(number) else "")
    if is_of_training(metric):
        value = record.train_scores.get(metric.removeprefix("train_"))
    else:
        value = record.scores.get(metric)
    return (np.nan, record.missing.get(metric, "not scored")) if value is None else (value, "")


def planned_iterations(record: Record) -> int:
    """Return iterations of a cell's budget; those that it made, where its record has no budget or it does not train."""
    planned = record.setting("budget.iterations")
    return planned if isinstance(planned, int) and record.made_elsewhere is None else record.iterations


def iterations_in_words(records: Sequence[Record]) -> str:
    """Return after how many iterations trainings ended, and of how many; `n/a` of what was made elsewhere.

    >>> cells = [Record("tdg", "", "a", "", seed, "", "", iterations=n) for seed, n in enumerate((800, 900))]
    >>> iterations_in_words(cells), iterations_in_words(cells[:1])
    ('800 to 900', '800')
    """
    trained = [record for record in records if record.made_elsewhere is None]
    if not trained:
        return "n/a"
    ended = [record.iterations for record in trained]
    planned, done = {*map(planned_iterations, trained)}, dict.fromkeys((min(ended), max(ended)))
    words = " to ".join(map(str, done))
    return words if planned <= {*ended} else f"{words} of at most {max(planned)}"


def cell_rows(
    records: Iterable[Record], plan: Plan, init: str | None = None, asked: Iterable[str] = ()
) -> pd.DataFrame:
    """Return rows (KEYS, seed, value, reason) of every method × scene × metric × record; n/a where there is no record.

    With `init` only its records count, on the scenes of all, and inits do not make columns. asked: further metrics.
    """
    by_place: dict[tuple[str, str, str], list[Record]] = {}
    records = list(records)
    chosen = [r for r in records if init in (None, r.init)]
    for record in chosen:
        place = (method_label(record, with_init=init is None), record.dataset, record.scene)
        by_place.setdefault(place, []).append(record)
    labels = {label for label, _, _ in by_place}
    scenes = _scenes(records, plan)
    of_paper = any(s.dataset in DATASETS.values() for s in scenes)
    without_records = {*plan.methods, *(methods.paper_pair() if of_paper else ())} - {r.method for r in chosen}
    rows = []
    for method in sorted({*labels, *without_records}, key=methods.rank):
        for scene in scenes:
            found = by_place.get((method, scene.dataset, scene.scene), [])
            for metric in (*COLUMNS, *further(), *asked):
                key = [method, scene.dataset, scene.group, scene.scene, metric]
                numbers = [[r.seed, *metric_value(r, metric)] for r in found] or [[np.nan, np.nan, NO_RECORD]]
                rows += [[*key, *number] for number in numbers]
    return pd.DataFrame(rows, columns=[*KEYS, "seed", "value", "reason"])


def scene_rows(cells: pd.DataFrame) -> pd.DataFrame:
    """Return rows (KEYS, value, reason): means over the seeds of `cell_rows`; n/a if any seed lacks the number."""
    lacking = cells["reason"] != ""
    groups = cells.assign(lacking=lacking, reason=cells["reason"].where(lacking)).groupby(KEYS, sort=False)
    found = groups.agg(reason=("reason", "first"), lacking=("lacking", "sum"), seeds=("lacking", "size"))
    is_some = (found["lacking"] > 0) & (found["lacking"] < found["seeds"])
    some = "in " + found["lacking"].astype(str) + " of " + found["seeds"].astype(str) + " seeds " + found["reason"]
    reasons = found["reason"].where(~is_some, some).fillna("")
    return means(cells, KEYS).join(reasons).reset_index()


def means(rows: pd.DataFrame, over: list[str], columns: Sequence[Hashable] = ("value",)) -> pd.DataFrame:
    """Return the mean of columns over each group of rows, with the index `over`; NaN if any is."""
    groups = rows.groupby(over, sort=False)[list(columns)]
    found = {key: group.to_numpy().T.copy().mean(axis=1) for key, group in groups}
    return pd.DataFrame(list(found.values()), pd.MultiIndex.from_tuples(found, names=over), columns)


def with_averages(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows and their averages per data set and overall; an average over a missing number is n/a."""
    parts = [rows, _averages(rows, ["method", "dataset", "metric"]).assign(scene=AVERAGE)]
    if rows["dataset"].nunique() > 1:
        parts.append(_averages(rows, ["method", "metric"]).assign(scene=OVERALL, dataset=""))
    table = pd.concat(parts, ignore_index=True)[[*KEYS, "value", "reason"]]
    nth_method, nth_dataset = ({name: i for i, name in enumerate(rows[c].unique())} for c in ("method", "dataset"))
    places = zip(table["method"], table["dataset"], table["scene"], strict=True)
    table["place"] = [(nth_method[m], s == OVERALL, nth_dataset.get(d, 0), s == AVERAGE) for m, d, s in places]
    return table.sort_values("place", kind="stable", ignore_index=True).drop(columns="place")


def with_protocols(rows: pd.DataFrame, records: Iterable[Record]) -> pd.DataFrame:
    """Return the rows with ABOUT of their cells (`a + b` for an average over both).

    range_degC: °C of image values 0 and 1, if all cells have one: PSNR is relative to it.
    """

    def joined(text: Callable[[Record], str]) -> Callable[[Sequence[Record]], str]:
        return lambda cells: " + ".join(sorted({text(cell) for cell in cells} - {""}))

    def range_of(cells: Sequence[Record]) -> str:
        found = {" to ".join(f"{end:.4g}" for end in cell.temperature_range or ()) for cell in cells}
        return found.pop() if len(found) == 1 else ""

    texts: list[Callable[[Record], str]] = [
        attrgetter("split"), attrgetter("protocol"), prior_in_words,
        lambda cell: "" if cell.scores.get("lpips") is None else str(cell.setting("metrics.lpips.net")),
    ]  # fmt: skip
    split, protocol, prior, net = map(joined, texts)
    columns = dict(zip(ABOUT, [split, protocol, iterations_in_words, prior, net, range_of], strict=True))
    return with_text_of_cells(rows, records, columns, partial(method_label, with_init=True))


def prior_in_words(record: Record) -> str:
    """Return what a cell's depth prior is made from if not from the thermal images alone, else its name, if any."""
    words = record.prior_source.words
    return f"made from {words}" if words else str(record.setting("prior.name") or "")


def split_notes(main: pd.DataFrame) -> list[str]:
    """Return the test views of a main table in words, one line for each split."""
    return [f"split {name}: {SPLITS.get(name, name)}" for name in dict.fromkeys(main["split"]) if name in SPLITS]


def protocol_notes(main: pd.DataFrame) -> list[str]:
    """Return the protocols of a main table, in a line."""
    single = [name for name in dict.fromkeys(main["protocol"]) if name and " + " not in name]
    if len(single) < 2:
        return [f"protocol {name}" for name in single]
    columns = {name: dict.fromkeys(main.loc[main["protocol"] == name, "method"]) for name in single}
    texts = (f"{name} ({', '.join(map(methods.label, of_name))})" for name, of_name in columns.items())
    return [f"several protocols, whose scores do not compare: {'; '.join(texts)}"]


def initial_points(ablation: pd.DataFrame) -> list[str]:
    """Return the origin of each init's initial points in an ablation, in words, where it is known."""
    hows = ablation.groupby("init", sort=False)["points"].first()
    return [f"{init}: {how}" for init, how in hows.items() if how]


def _averages(rows: pd.DataFrame, over: list[str]) -> pd.DataFrame:
    """Return an average over the scenes of each group of rows, and why it is n/a."""
    lacking = rows.assign(missing=rows["value"].isna()).groupby(over, sort=False)["missing"].agg(["sum", "size"])
    reasons = rows[rows["value"].isna() & (rows["reason"] != "")].groupby(over, sort=False)["reason"]
    known = means(rows, over).join([lacking, reasons.agg(one="first", count="nunique")])
    several = known["sum"].astype(str) + " of " + known["size"].astype(str) + " scenes are n/a"
    known["reason"] = (
        known["one"].where((known["count"] == 1) & (known["sum"] == known["size"]), several).where(known["sum"] > 0, "")
    )
    return known[["value", "reason"]].reset_index().assign(group="")


def _scenes(records: list[Record], plan: Plan) -> list[Description]:
    """Return the planned scenes and those of records; with one of the paper's scenes, all of them."""
    described = {(s.dataset, s.scene): s for s in plan.scenes}
    for r in records:
        described.setdefault((r.dataset, r.scene), Description(r.scene, r.dataset, r.group))
    paper = {(DATASETS[s.dataset], s.name): Description(s.name, DATASETS[s.dataset], s.group) for s in SCENES}
    if described.keys() & paper.keys():
        described = {**paper, **{k: v for k, v in described.items() if k not in paper}}
    return list(described.values())
