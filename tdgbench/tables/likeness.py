"""Which numbers may be compared: what has to agree between the trainings behind them.

Columns of a table differ in method, initial points, and what a sweep names. A method's options, its prior beside a
method without one, and lengths that its authors state are its own. All else has to agree: budget, iterations, prior,
backend, version, protocol, the scene's files, sizes and range; for times, the machine. Where it does not, columns are
no rivals, and a mean over unlike trainings is n/a.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from math import nan
from typing import NamedTuple

import pandas as pd

from tdgbench.cells.key import LACKING, differences, flat, with_rules
from tdgbench.cells.protocol import protocol_settings
from tdgbench.cells.record import Record
from tdgbench.tables import methods
from tdgbench.tables.measures import AVERAGE, HOURS, OVERALL
from tdgbench.text import as_typed, named

TRAINING_KIND = "training"  # column of main.csv: in what a row's training differs from others of its scene; or empty
GROUPS = ("budget", "prior", "skip", "thermal_camera")  # of options, that all methods share
OF_A_COLUMN = ("method.", "init.")  # options that agree within a column
OF_A_SCENE = ("scene's files", "image size", "range, °C")  # may differ between the scenes of an average
# Of times: names in `environment` of records.
MACHINE = {"processor": "cpu", "GPU": "gpu", "threads": "threads", "cells at once": "cells_at_once"}
ON_CPU = ("cpu", "reference")  # backends that leave a GPU idle
OF_SCORES = "metrics."
NAMED = ("budget", "prior")  # groups whose name stands for all their options
OWN = {  # options of budgets that a method's file states, by which key; their values in budget=paper if it does not
    "iterations": ("paper_iterations", 30000),
    "budget.rates.means_steps": ("paper_means_steps", 30000),
    "budget.density.stop": ("paper_density_stop", 15000),
    "budget.density.gradient": ("gradient", "signed"),
    "budget.density.grad_threshold": ("grad_threshold", 2.0e-4),
}
OF_GAUSSIANS = (  # options of budgets that radiance fields do not read
    "gaussians", "sh_degree", "sh_every", "background", "lift_dark_every", "rates", "density", "harmonics", "points",
    "growth",
)  # fmt: skip
BUSY = 1.25  # wall time of a training, in its processor time, above which other work ran
IGNORED = ("_target_", "seed", "convention")  # last part of an option's name
# of what other programs made: where it lies
PLACES = ("method.folder", "method.ply", "method.method.folder", "method.method.ply")
AUTHORS = "as its authors state"  # in the place of values of OWN
MOST_SCENES = 3  # of a difference that is another one in each scene
RANK_UNLIKE = "--rank-unlike"
NOT_COMPARED = (
    "unlike trainings: they are not compared, and means over them are n/a "
    f"(tdgbench tables DIR {RANK_UNLIKE}: they are)"
)
SELECTED = "its checkpoint was chosen by test views, so its scores are too high beside the others"
RANKED = f"unlike trainings: they are ranked and averaged all the same, as {RANK_UNLIKE} asks"


class Difference(NamedTuple):
    """In what columns differ. values: of each column that has any; several where the column is of unlike trainings."""

    name: str
    values: Mapping[str, tuple[str, ...]]


class Trainings:
    """The trainings behind the columns of a table. column: a cell's. is_ranking_unlike: nothing is set apart."""

    def __init__(self, records: Iterable[Record], column: Callable[[Record], str], is_ranking_unlike: bool) -> None:
        finished = [record for record in records if record.failure is None]
        self._cells = [(one, column(one), traits) for one, traits in zip(finished, _traits(finished), strict=True)]
        self._is_ranking_unlike = is_ranking_unlike
        self._found: dict[tuple[str, str, bool], list[Difference]] = {}

    def of(self, dataset: str, scene: str, timed: bool) -> list[Difference]:
        """Return in what the columns differ on a scene, or over the scenes of an average. timed: of times."""
        place = dataset, scene, timed
        if place not in self._found:
            is_average = scene in (AVERAGE, OVERALL)
            columns: dict[str, list[dict[str, object]]] = {}
            for record, column, traits in self._cells:
                if dataset in ("", record.dataset) and (is_average or record.scene == scene):
                    columns.setdefault(column, []).append(traits)
            left_out = (*(OF_A_SCENE if is_average else ()), *(() if timed else MACHINE))
            found = _differences(columns, left_out)
            if is_average:  # of scenes, on each of which these have to agree
                scenes = dict.fromkeys((r.dataset, r.scene) for r, *_ in self._cells if dataset in ("", r.dataset))
                found += [one for each in scenes for one in self.of(*each, timed) if one.name in OF_A_SCENE]
            self._found[place] = [one for one in found if not (timed and one.name.startswith(OF_SCORES))]
        return self._found[place]

    def set_apart(self, table: pd.DataFrame) -> tuple[pd.DataFrame, list[str], list[str]]:
        """Return a main table with TRAINING_KIND, notes on differences, and problems: numbers that are n/a.

        Those of unlike trainings in one column are, with the reason.
        """
        is_timed = table["metric"] == HOURS.name
        places = list(zip(table["method"], table["dataset"], table["scene"], is_timed, strict=True))
        texts, reasons = {}, {}
        for column, dataset, scene, timed in () if self._is_ranking_unlike else set(places):
            differ = self.of(dataset, scene, timed)
            known = [(one.name, one.values[column]) for one in differ if column in one.values]
            texts[column, dataset, scene, timed] = "; ".join(f"{name}: {' and '.join(v)}" for name, v in known)
            mixed = [f"{name}: {', '.join(values)}" for name, values in known if len(values) > 1]
            if mixed:
                what = "its scenes or seeds" if scene in (AVERAGE, OVERALL) else "its seeds"
                reasons[column, dataset, scene, timed] = f"{what} are unlike trainings ({'; '.join(mixed)})"
        table = table.assign(**{TRAINING_KIND: [texts.get(place, "") for place in places]})
        unlike = pd.Series([reasons.get(place, "") for place in places], table.index, dtype=str)
        is_mixed = (unlike != "") & table["value"].notna()
        numbers = [name for name in ("value", "std", "ci95_low", "ci95_high") if name in table]
        table.loc[is_mixed, numbers] = float("nan")
        table.loc[is_mixed, "reason"] = unlike[is_mixed]
        return table, self._notes(), _problems(table[is_mixed])

    def _notes(self) -> list[str]:
        """Return a line for each difference: what differs, its values, and the columns and scenes that have them."""
        scenes = list(dict.fromkeys((record.dataset, record.scene) for record, *_ in self._cells))
        averages = [(dataset, AVERAGE) for dataset in dict.fromkeys(dataset for dataset, _ in scenes)]
        found: dict[str, dict[str, list[str]]] = {}
        for dataset, scene in (*scenes, *averages):
            for one in self.of(dataset, scene, timed=True) + self.of(dataset, scene, timed=False):
                is_said = scene == AVERAGE and one.name in found
                text = _by_value(one)
                if not is_said and scene not in found.setdefault(one.name, {}).setdefault(text, []):
                    found[one.name][text].append(scene)
        if not found:
            return []
        lines = []
        for name, by_text in found.items():
            parts = [
                text + ("" if len(places) == len(scenes) or AVERAGE in places else f" on {', '.join(places)}")
                for text, places in list(by_text.items())[:MOST_SCENES]
            ]
            more = f" and {len(by_text) - MOST_SCENES} more" if len(by_text) > MOST_SCENES else ""
            alone = ", of times alone" if name in MACHINE else ""
            lines.append(f"unlike trainings{alone}: {name}: {'; '.join(parts)}{more}")
        return [*lines, RANKED if self._is_ranking_unlike else NOT_COMPARED]


def setups(records: Sequence[Record], timed: bool = False, with_length: bool = False) -> list[str]:
    """Return a text for each cell. Two cells may be compared if their texts are equal.

    Scene, split and all that has to agree but what pairs may differ in: method and its options, prior, initial points,
    seed and number of iterations. timed: times compare, so the machine has to agree. with_length: so do the iterations,
    unless they are those that the method's authors state. An option that is null equals one that a record lacks: it is
    of a version before there was the option.
    """
    left_out = ("budget", "prior", *(() if timed else MACHINE), *(() if with_length else ("iterations",)))
    cells, stated = [], dict[tuple[str, str], set[Hashable]]()  # stated: by authors, of cells that are alike otherwise
    for record, traits in zip(records, _traits(records), strict=True):
        kept = {
            name: value for name, value in traits.items()
            if value is not None and name not in left_out and not name.startswith((*OF_A_COLUMN, "prior."))
        }  # fmt: skip
        place = [record.dataset, record.scene, record.split]
        others = {name: value for name, value in kept.items() if name not in OWN}
        alike = json.dumps([*place, others], sort_keys=True, default=str)
        cells.append((place, alike, kept))
        for name, value in kept.items():
            if isinstance(value, _Own):
                stated.setdefault((alike, name), set()).add(_plain(value))
    unequal = {one for one, values in stated.items() if len(values) > 1}  # else the number itself is compared
    found = []
    for place, alike, kept in cells:
        shown = {name: AUTHORS if (alike, name) in unequal and isinstance(value, _Own) else _plain(value)
                 for name, value in kept.items()}  # fmt: skip
        found.append(json.dumps([*place, shown], sort_keys=True, default=str))
    return found


def machine(record: Record) -> tuple[str, ...]:
    """Return what a cell's times depend on, a text for each of MACHINE; `None` where it is not recorded."""
    return tuple(map(str, _of_machine(record).values()))


def machine_in_words(machine: tuple[str, ...]) -> str:
    """Return a cell's `machine` as readers see it.

    >>> machine_in_words(("Xeon", "None", "2", "None"))
    'Xeon, threads: 2, cells at once: not recorded'
    """
    cpu, gpu, threads, at_once = ("not recorded" if text == "None" else text for text in machine)
    return f"{cpu if machine[1] == 'None' else gpu}, threads: {threads}, cells at once: {at_once}"


def times_at_once(records: Iterable[Record]) -> list[str]:
    """Return the note that cells shared a machine, in a list; empty if each ran alone."""
    found = (record.environment.get("cells_at_once") for record in records)
    numbers = sorted({number for number in found if isinstance(number, int)})
    if not numbers or numbers[-1] < 2:
        return []
    return [f"times are of {' or '.join(map(str, numbers))} cells at once, which may slow each other down"]


def was_disturbed(record: Record) -> bool:
    """Return whether other work took processor time from a training on the CPU, so that its time says little."""
    return _wall_by_processor_time(record) > BUSY


def _wall_by_processor_time(record: Record) -> float:
    seconds = record.seconds.get("train", 0.0)
    return wall_by_processor_time(seconds, record.train_processor_seconds, record.backend)


def wall_by_processor_time(seconds: float, of_processor: float | None, backend: str) -> float:
    """Return the wall time of a training on the CPU over its processor time; NaN where that is not known."""
    return seconds / max(of_processor, 1e-9) if backend in ON_CPU and of_processor is not None else nan


def disturbed_notes(records: Iterable[Record]) -> list[str]:
    """Return the note on trainings beside other work, in a list; empty without any."""
    records = list(records)
    busy = [ratio for ratio in map(_wall_by_processor_time, records) if ratio > BUSY]
    if not busy:
        return _uneven_times(records)
    ratio = f"wall time up to {max(busy):.1f} times the processor time"
    return [f"times of {len(busy)} of {len(records)} cells are of a busy machine ({ratio}): they are not compared"]


def _uneven_times(records: Iterable[Record]) -> list[str]:
    """Return a note where seeds of a method with several threads had unlike shares of their cores, in a list."""
    groups: dict[tuple[object, ...], list[float]] = {}
    for record in records:
        threads = record.environment.get("threads")
        if isinstance(threads, int) and threads > 1 and (ratio := _wall_by_processor_time(record)) > 0:
            place = record.method, record.variant, record.dataset, record.scene, threads
            groups.setdefault(place, []).append(ratio)
    uneven = [shares for shares in groups.values() if max(shares) > BUSY * min(shares)]
    if not uneven:
        return []
    shares = max(uneven, key=lambda shares: max(shares) / min(shares))
    span = f"wall time {min(shares):.2f} to {max(shares):.2f} of the processor time"
    return [f"times of cells with several threads, {span}: other work may have slowed some seeds"]


def is_selected(record: Record) -> bool:
    """Return whether test views chose the checkpoint behind a cell's scores."""
    return dict(record.made_elsewhere or {}).get("checkpoint_rule") == "best_test_view"


def selected_notes(records: Iterable[Record], column: Callable[[Record], str]) -> list[str]:
    """Return a note for each column with such cells."""
    chosen = dict.fromkeys(column(record) for record in records if is_selected(record))
    return [f"selected: {methods.label(name)}: {SELECTED}" for name in chosen]


def _problems(unlike: pd.DataFrame) -> list[str]:
    """Return a problem for each column and scene of rows whose means are of unlike trainings."""
    places = unlike[["method", "dataset", "scene", "reason"]].drop_duplicates()
    is_average = places["scene"].isin((AVERAGE, OVERALL))
    places = places[~is_average | ~places["method"].isin(places.loc[~is_average, "method"])]  # whose scenes say it
    return [
        f"{methods.label(row.method)} on {row.dataset}/{row.scene}: {row.reason}; run them alike, or delete those that "
        "are not meant"
        for row in places.itertuples()
    ]


def _by_value(one: Difference) -> str:
    """Return the values, and the columns that have them: `400 (MSMG, TDg), 15000 (3DGS)`."""
    columns: dict[str, list[str]] = {}
    for column, values in one.values.items():
        columns.setdefault(" and ".join(values), []).append(methods.label(column))
    return ", ".join(f"{value} ({named(names)})" for value, names in columns.items())


def _differences(columns: Mapping[str, Sequence[Mapping[str, object]]], left_out: Sequence[str]) -> list[Difference]:
    """Return the traits in which columns differ. A trait that a cell lacks equals any value."""
    cells = [(column, traits) for column, of_column in columns.items() for traits in of_column]
    stated = {name for _, traits in cells for name, v in traits.items() if isinstance(v, _Own) and v.is_stated}
    values_of = [
        {name: AUTHORS if name in stated and isinstance(value, _Own) else _plain(value)
         for name, value in traits.items() if name not in left_out} for _, traits in cells
    ]  # fmt: skip
    unequal = differences([{name: _plain(value) for name, value in traits.items()} for _, traits in cells])
    found: dict[str, Difference] = {}
    for name, values in sorted(differences(values_of).items(), key=lambda one: one[0] not in NAMED):  # then options
        if name not in unequal or any(name.startswith(f"{group}.") and group in found for group in NAMED):
            continue
        kept: dict[str, dict[object, str]] = {}
        for (column, _), value in zip(cells, values, strict=True):
            if value is not LACKING:
                kept.setdefault(column, {})[value] = as_typed(value)
        if name.startswith(OF_A_COLUMN):
            kept = {column: texts for column, texts in kept.items() if len(texts) > 1}
        if kept:
            found[name] = Difference(name, {column: tuple(texts.values()) for column, texts in kept.items()})
    return list(found.values())


class _Own(NamedTuple):
    """The value of an option as the method's authors have it. is_stated: by the method's file, else by budget=paper."""

    value: object
    is_stated: bool


def _plain(value: object) -> Hashable:
    """Return a value as it is compared: without its mark, and as text if it cannot be hashed."""
    value = value.value if isinstance(value, _Own) else value
    return value if isinstance(value, Hashable) else as_typed(value)


def _traits(records: Sequence[Record]) -> list[dict[str, object]]:
    """Return what has to agree, by its name in print: for options, that of the command line.

    Equal code has one version, as the first cell of it names it: commits may differ in other files.
    """
    versions: dict[str, str] = {}
    return [
        _traits_of(one) | ({"tdgbench": versions.setdefault(one.code, version(one))} if one.code else {})
        for one in records
    ]


def _traits_of(record: Record) -> dict[str, object]:
    config = {name: part for name, part in record.config.items() if isinstance(part, dict)}
    groups = (*(() if record.made_elsewhere else GROUPS), "method", "init")
    options = with_rules(flat({name: config[name] for name in groups if name in config})) | protocol_settings(config)
    traits: dict[str, object] = {}
    for name, value in options.items():
        is_place = record.made_elsewhere is not None and name in PLACES
        if name.rpartition(".")[2] not in IGNORED and name not in ("method.name", "init.name") and not is_place:
            traits[{"budget.iterations": "iterations"}.get(name, name.removesuffix(".name"))] = value
    for name, (key, otherwise) in OWN.items():
        stated = record.setting(f"method.{key}")
        chosen = "budget.iterations" if name == "iterations" else name
        own = otherwise if stated is None else stated
        if name in traits and traits[name] == own and chosen not in record.variant:
            traits[name] = _Own(traits[name], stated not in (None, otherwise))
    others = {
        "protocol": record.protocol_number, "backend": "" if record.made_elsewhere else record.backend,
        "scene's files": record.scene_files, "image size": record.assumed.get("size", ""),
        "range, °C": " to ".join(f"{end:g}" for end in record.temperature_range or ()),
        **({} if record.made_elsewhere else _of_machine(record)),  # the times of others are n/a
    }  # fmt: skip
    found = traits | {name: value for name, value in others.items() if value}
    return {name: value for name, value in found.items() if not _is_unread(name, record)}


def _is_unread(name: str, record: Record) -> bool:
    """Return whether a method reads no such option: those of Gaussians without these, those of a field beside them.

    Without Gaussians, `cpu` and `reference` are one, too.
    """
    if not record.parts:  # it failed, or was made elsewhere
        return False
    if record.gaussians:
        return name.startswith("budget.field.")
    is_of_gaussians = name.startswith("budget.") and name.split(".")[1] in OF_GAUSSIANS
    return is_of_gaussians or (name == "backend" and record.backend in ON_CPU)


def _of_machine(record: Record) -> dict[str, object]:
    """Return what a cell's times depend on, by its name in print. A GPU counts by its name, where it trained."""
    found = {name: record.environment.get(stored) for name, stored in MACHINE.items()}
    gpu = None if record.backend in ON_CPU else found["GPU"]
    return found | {"GPU": gpu.get("name") if isinstance(gpu, dict) else gpu}


def version(record: Record) -> str:
    """Return version and commit, as `0.1.0 (2f683cd)`."""
    packages, git = (
        part if isinstance(part, dict) else {} for part in map(record.environment.get, ("packages", "git"))
    )
    commit = str(git.get("commit", ""))[:7] + (" with changes" if git.get("dirty") else "")
    return f"{packages.get('tdgbench', 'unknown')}{f' ({commit})' if commit else ''}"
