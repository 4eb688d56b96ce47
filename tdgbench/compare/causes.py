"""What differs between two experiments behind their scores: protocol, training, code, machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

from tdgbench.cells.ground_truth import views_with_other_truth
from tdgbench.cells.key import differences, flat
from tdgbench.cells.protocol import MEASURED_ON
from tdgbench.cells.record import Record
from tdgbench.compare.compared_cells import ComparedCell
from tdgbench.text import as_typed, one_line

PROTOCOL, TRAINING, MACHINE = "protocol", "training", "machine"
KINDS = {
    PROTOCOL: "decides what a score means; numbers of two protocols are not comparable",
    TRAINING: "decides what is trained",
    MACHINE: "decides rounding and time",
}
OF_PROTOCOL = ("protocol", "data", *MEASURED_ON)  # fields of Record
OF_TRAINING = ("iterations", "backend", "code", "prior", "init_points")
PROTOCOL_OPTIONS = ("dataset", "metrics")  # groups of the configuration
ELSEWHERE = ("metrics.lpips.weights",)  # says where weights are, not which they are
TRUTH = PROTOCOL, "ground truth"


class Cause(NamedTuple):
    """One setting that differs. values: A's and B's, the most frequent ones. cells: pairs in which it differs."""

    kind: str
    name: str
    values: tuple[str, str]
    cells: int

    def sentence(self, pairs: int) -> str:
        """Return `budget.iterations: 3000 → 1200`, and in how many of the pairs if not in all."""
        some = "" if self.cells == pairs else f" (in {self.cells} of {pairs} cells)"
        return f"{self.name}: {self.values[0]} → {self.values[1]}{some}"


def find_causes(pairs: Iterable[ComparedCell]) -> list[Cause]:
    """Return every setting that differs in a pair, by kind, most frequent ones first; their ground truth among them."""
    found: dict[tuple[str, str], Counter[tuple[str, str]]] = {}
    for pair in pairs:
        a, b = settings(pair.a.record), settings(pair.b.record)
        a[TRUTH], b[TRUTH] = "A's", truth_in_words(pair)
        for key, (mine, theirs) in differences([a, b], "n/a").items():
            found.setdefault(key, Counter())[mine, theirs] += 1
    causes = [Cause(*key, counts.most_common(1)[0][0], counts.total()) for key, counts in found.items()]
    kinds = list(KINDS)
    return sorted(causes, key=lambda cause: (kinds.index(cause.kind), -cause.cells))


def truth_in_words(pair: ComparedCell) -> str:
    """Return whose ground truth the second cell of a pair was scored against, by their pictures."""
    there = set(pair.b.views_with_truth())
    common = [view for view in pair.a.views_with_truth() if view in there]
    try:
        other = views_with_other_truth(pair.a, pair.b, common)
    except (ValueError, OSError) as error:
        return f"unknown, since {one_line(str(error))}"
    return f"another one in {len(other)} of {len(common)} test views" if other else "A's"


def settings(record: Record) -> dict[tuple[str, str], str]:
    """Return everything behind a cell's scores as text, by kind and dotted name."""
    whole: dict[str, dict[str, Any]] = {PROTOCOL: {}, TRAINING: {}, MACHINE: dict(record.environment)}
    for kind, fields in ((PROTOCOL, OF_PROTOCOL), (TRAINING, OF_TRAINING)):
        whole[kind] |= {name: getattr(record, name) for name in fields}
    for group, options in record.config.items():
        whole[PROTOCOL if group in PROTOCOL_OPTIONS else TRAINING][group] = options
    named = [(kind, name, value) for kind, of_kind in whole.items() for name, value in flat(of_kind).items()]
    return {(MACHINE if name in ELSEWHERE else kind, name): as_typed(value) for kind, name, value in named}
