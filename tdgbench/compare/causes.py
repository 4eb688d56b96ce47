"""What differs between two experiments behind their scores: protocol, training, code, machine, version."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

from tdgbench.cells.ground_truth import views_with_other_truth
from tdgbench.cells.key import differences, flat
from tdgbench.cells.protocol import MEASURED_ON
from tdgbench.cells.record import Record
from tdgbench.compare.pairs import ComparedCell, Pairs, Place, place_of
from tdgbench.scoring import METRICS
from tdgbench.tables import likeness, methods
from tdgbench.tables.long_table import planned_iterations
from tdgbench.tables.measures import known_measures, measure_of
from tdgbench.text import as_typed, named, one_line

PROTOCOL, TRAINING, MACHINE, VERSION = "protocol", "training", "machine", "version"
KINDS = {
    PROTOCOL: "decides what a score means: none is compared across two",
    TRAINING: "decides what is trained",
    MACHINE: "decides rounding and time",
    VERSION: "decides nothing by itself: code and hashes say what differs",
}
DATA = "data"  # of the scene
OF_PROTOCOL = MEASURED_ON  # fields of Record
OF_TRAINING = ("code", "prior", "init_points")
PROTOCOL_OPTIONS = ("dataset", "metrics")  # groups of the configuration
# the last says where weights are, not which
OF_VERSION = ("git.commit", "git.dirty", "packages.tdgbench", "metrics.lpips.weights")
NAME = "metrics.convention"  # of other options of metrics
ADDED = "metrics.extra"  # changes no other score
TRUTH = PROTOCOL, "ground truth"
LACKING = "not recorded"
PLANNED = "budget.iterations"
OF_TIMES = (*likeness.MACHINE.values(), "cores", "simd_lanes")  # fields of a record's environment
MADE_FROM = "prior.made_from"  # first of the options of a prior, with its values
LONGEST = 12  # characters of a value that a sentence prints


class Cause(NamedTuple):
    """One setting that differs. values: A's and B's, the most frequent ones. cells: pairs in which it differs.

    in_part: whether it differs in some seeds of a place alone.
    """

    kind: str
    name: str
    values: tuple[str, str]
    cells: int
    places: frozenset[Place]
    alike: int  # pairs in which it differs by just these values
    in_part: bool = False

    @property
    def change(self) -> str:
        """`budget.iterations: 3000 → 1200`."""
        return f"{self.name}: {self.values[0]} → {self.values[1]}"

    @property
    def brief(self) -> str:
        """The change, `iterations 3000 → 1200`; of hashes and long values the name."""
        is_short = self.name != "code" and (max(map(len, self.values)) <= LONGEST or self.name == MADE_FROM)
        return f"{self.name} {' → '.join(self.values)}" if is_short and not self.varies else self.name

    @property
    def varies(self) -> bool:
        """Whether it differs in several ways, so that its values are those of some pairs."""
        return self.alike < self.cells

    @property
    def scores(self) -> Collection[str]:
        """The scores whose meaning it decides."""
        if self.kind != PROTOCOL or self.name == ADDED:
            return ()
        option = self.name.removeprefix("metrics.")
        named = [name for name, metric in METRICS.items() if self.name != option in metric.options]
        return [one for name in named for one in (name, f"train_{name}")] or known_measures()

    @property
    def scope(self) -> str:
        """What it decides, `LPIPS alone`, where a setting of the protocol does not decide all scores; else empty."""
        if self.name == ADDED:
            return "adds scores"
        labels = dict.fromkeys(measure_of(name).label for name in self.scores if name in known_measures())
        return f"{', '.join(labels)} alone" if self.scores and self.scores != known_measures() else ""

    def sentence(self, pairs: int) -> str:
        """Return the change, which scores it decides, and in how many of the pairs it is if not in all."""
        where = named(f"{methods.label(method)} on {scene}" for _, scene, method, *_ in sorted(self.places))
        seeds = ", some of their seeds alone" * self.in_part
        some = "" if self.cells == pairs else f" (in {self.cells} of {pairs} cells: {where}{seeds})"
        if self.varies:
            some = f" (so in {self.alike} of {self.cells} cells that differ, of {pairs}; otherwise in the others)"
        return f"{self.change}{f' ({self.scope})' if self.scope else ''}{some}"


def find_causes(pairs: Pairs) -> list[Cause]:
    """Return every setting that differs in a pair, by kind, most frequent ones first; their ground truth among them.

    An option that is null equals one that a record lacks: it is of a version before there was the option. Another
    option of the budget that a record lacks is a difference of versions, unless the record has null in its group.
    """
    found: dict[tuple[str, str], Counter[tuple[str, str]]] = {}
    places: dict[tuple[str, str], Counter[Place]] = {}
    for pair in pairs:
        a, b = settings(pair.a.record), settings(pair.b.record)
        a[TRUTH], b[TRUTH] = "A's", truth_in_words(pair)
        for key, (mine, theirs) in differences([a, b], LACKING).items():
            if LACKING in (mine, theirs) and _is_unlisted(key, a if mine == LACKING else b):
                continue
            if {mine, theirs} != {LACKING, "null"} and key != (TRAINING, PLANNED):  # `iterations` says it
                if LACKING in (mine, theirs) and _is_newer(key[1], *((a, b) if mine == LACKING else (b, a))):
                    key = VERSION, key[1]
                found.setdefault(key, Counter())[mine, theirs] += 1
                places.setdefault(key, Counter())[place_of(pair.a.record)] += 1
    causes = []
    for key, counts in found.items():
        (values, alike), cells = counts.most_common(1)[0], places[key]
        in_part = any(number < len(pairs.by_place[place]) for place, number in cells.items())
        causes.append(Cause(*key, values, counts.total(), frozenset(cells), alike, in_part))
    kinds = list(KINDS)
    return sorted(causes, key=lambda cause: (kinds.index(cause.kind), -cause.cells, cause.name != MADE_FROM))


def _is_unlisted(key: tuple[str, str], lacking: Mapping[tuple[str, str], str]) -> bool:
    """Return whether a package is one that the version of a record with others did not list."""
    kind, name = key
    return name.startswith("packages.") and any(one[0] == kind and one[1].startswith("packages.") for one in lacking)


def _is_newer(name: str, lacking: Mapping[tuple[str, str], str], having: Mapping[tuple[str, str], str]) -> bool:
    """Return whether an option is one of the budget that the version of a record without it did not have.

    It is not, where its group is null there, or of another kind.
    """
    parts = name.split(".")
    groups = [".".join(parts[:n]) for n in range(2, len(parts))]
    is_off = any((TRAINING, group) in lacking for group in groups)
    kinds = [(TRAINING, f"{group}._target_") for group in groups]
    is_alike = all(kind not in lacking or lacking[kind] == having.get(kind) for kind in kinds)
    return parts[0] == "budget" and (TRAINING, PLANNED) in lacking and not is_off and is_alike


def in_brief(causes: Iterable[Cause]) -> str:
    """Return the first changes of some causes."""
    return named(cause.brief for cause in causes)


def is_of_times(cause: Cause) -> bool:
    """Return whether a setting of the machine decides times."""
    return cause.kind == MACHINE and cause.name.split(".")[0] in OF_TIMES


def why_no_times(causes: Iterable[Cause]) -> str:
    """Return why times do not compare: other images or length, or another training on another machine; else empty."""
    causes = list(causes)
    if images := [cause for cause in causes if cause.name == "channels" or cause.name.startswith("dataset.")]:
        return in_brief(images)
    of_machine = [cause for cause in causes if is_of_times(cause)]
    trained = [cause for cause in causes if cause.kind == TRAINING and cause.name != "code"]
    if any(cause.name == "iterations" for cause in trained) or (trained and of_machine):
        return in_brief(sorted([*of_machine, *trained], key=lambda cause: "iterations" not in cause.name))
    return ""


def truth_in_words(pair: ComparedCell) -> str:
    """Return whose ground truth the second cell of a pair was scored against, by their pictures."""
    views, there = pair.a.views_with_truth(), pair.b.views_with_truth()
    if views != there:
        return "unknown, since none is stored" if not (views and there) else "that of other test views"
    try:
        other = views_with_other_truth(pair.a, pair.b, views)
    except (ValueError, OSError) as error:
        return f"unknown, since {one_line(str(error))}"
    return f"another one in {len(other)} of {len(views)} test views" if other else "A's"


def settings(record: Record) -> dict[tuple[str, str], str]:
    """Return everything behind a cell's scores as text, by kind and dotted name."""
    whole: dict[str, dict[str, Any]] = {
        PROTOCOL: {"protocol": record.protocol_number, DATA: record.scene_files},
        TRAINING: {"made elsewhere": {**(record.made_elsewhere or {}), "summary": None}},
        MACHINE: dict(record.environment),
    }  # fmt: skip
    if record.made_elsewhere is None:
        whole[TRAINING]["files of the prior"] = record.further_files or None
    for kind, fields in ((PROTOCOL, OF_PROTOCOL), (TRAINING, OF_TRAINING)):
        whole[kind] |= {name: getattr(record, name) for name in fields}
    if record.in_palette:  # which earlier versions gave the range of its files where it was made gray
        whole[PROTOCOL]["temperature_range"] = None
    whole[TRAINING]["backend that trained"] = record.backend  # the option may be `auto`
    whole[TRAINING]["iterations"] = planned_iterations(record)  # after how many a rule ends it is an outcome
    for group, options in record.config.items():
        of_kind = whole[PROTOCOL if group in PROTOCOL_OPTIONS else TRAINING]
        both = isinstance(options, dict) and isinstance(of_kind.get(group), dict)
        of_kind[group] = {**of_kind[group], **options} if both else options  # a record's `prior` is a group, too
    named = [(kind, name, value) for kind, of_kind in whole.items() for name, value in flat(of_kind).items()
             if name != NAME]  # fmt: skip
    return {(VERSION if name in OF_VERSION else kind, name): as_typed(value) for kind, name, value in named}
