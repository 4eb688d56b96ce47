"""What depth priors may be made from, `made_from` in conf/prior/, and how far scores of their methods are evidence."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

PriorSource = Literal["thermal images", "points", "truth", "files"]
POINTS: Final = "points"


class Source(NamedTuple):
    """What a prior is made from. counts: whether claims of the paper count trainings with it."""

    words: str = ""  # behind `made from`, where more than the thermal images
    remark: str = ""  # in brackets behind them
    in_report: str = ""  # behind both
    counts: bool = True

    @property
    def in_full(self) -> str:
        return f"{self.words} ({self.remark})" if self.remark else self.words


SOURCES: dict[PriorSource, Source] = {
    "thermal images": Source(),
    "points": Source(
        "the scene's sparse points", "COLMAP mostly finds them in RGB images",
        "; no evidence for thermal images alone", counts=False,
    ),
    # of built-in scenes, which decide no claim
    "truth": Source("true depth", in_report=", with made-up errors, smaller than those of a monocular network"),
    "files": Source("files of unknown origin", in_report="; no evidence for thermal images alone", counts=False),
}  # fmt: skip
UNKNOWN = Source("an unknown source", counts=False)
MADE_UP = "in this built-in scene drawn from true depth, with noise"  # sparse points, which COLMAP did not find
BUILT_IN_POINTS = SOURCES[POINTS]._replace(remark=MADE_UP)


def source_of(made_from: str, is_built_in: bool = False) -> Source:
    """Return the source that a record states; one without a prior, or of an early version, states none.

    is_built_in: whether it is the record of a built-in scene, whose points are not COLMAP's.

    >>> source_of("truth").words, source_of("").counts, source_of("dreams").counts
    ('true depth', True, False)
    """
    if is_built_in and made_from == POINTS:
        return BUILT_IN_POINTS
    known = (source for name, source in SOURCES.items() if name == made_from)
    return next(known, UNKNOWN if made_from else Source())
