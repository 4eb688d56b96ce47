"""Judge depth priors on a scene: their error in each training view, or the reason why they cannot be had."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.experiments.priors.accuracy import Accuracy, accuracy
from tdgbench.experiments.priors.truth import MIN_POINTS, KnownDepth, halves, known_depth, source
from tdgbench.priors import DepthPrior, PriorError, estimate_all, prepare
from tdgbench.scenes import Scene


class Judged(NamedTuple):
    """A prior on a scene. views: its error by training view; those that show too little known depth are left out."""

    kind: str = ""
    views: dict[str, Accuracy] = {}  # noqa: RUF012 (never changed)
    reason: str = ""  # why there is no prior; then the rest is empty

    @property
    def mean(self) -> Accuracy | None:
        """Means over the views; None without any."""
        return Accuracy(*map(float, np.mean(list(self.views.values()), axis=0))) if self.views else None


def judge(prior: DictConfig, scene: Scene, cache: Path | None) -> Judged:
    """Judge a prior, configured as in `conf/prior/`, on a scene. cache: see `estimate_all`."""
    given, points = halves(scene)
    try:
        estimator = instantiate(prior.estimator)
        prepare(estimator)
        maps, _ = estimate_all(estimator, given if prior.get("made_from") == "points" else scene, cache)
    except PriorError as error:
        return Judged(reason=str(error).splitlines()[0])
    kind = next(iter(maps.values())).kind
    if not source(scene):
        return Judged(kind)
    found = {view.name: _of_view(maps[view.name], known_depth(view, points)) for view in scene.train}
    return Judged(kind, {name: one for name, one in found.items() if one is not None})


def _of_view(prior: DepthPrior, known: KnownDepth | None) -> Accuracy | None:
    """Error of a map where depth is known and the prior is finite; None where that is too little."""
    if known is None:
        return None
    values = prior.values[known.rows, known.columns]
    finite = np.isfinite(values)
    return accuracy(values[finite], prior.kind, known.z[finite]) if finite.sum() >= MIN_POINTS else None
