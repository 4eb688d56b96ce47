"""Estimate every training view's prior once: results are kept on disk by image hash and estimator."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tdgbench.files import whole_file
from tdgbench.priors.prior import DepthEstimator, DepthPrior
from tdgbench.scenes import Scene, View


def estimate_all(
    estimator: DepthEstimator, scene: Scene, cache: Path | None, report: Callable[[int, int], None] | None = None
) -> dict[str, DepthPrior]:
    """The priors of the training views by name; `report` is told (done, of) after each."""
    priors = {}
    for index, view in enumerate(scene.train, start=1):
        priors[view.name] = _cached(estimator, scene, view, cache).check(view)
        if report is not None:
            report(index, len(scene.train))
    return priors


def _cached(estimator: DepthEstimator, scene: Scene, view: View, cache: Path | None) -> DepthPrior:
    if cache is None:
        return estimator.estimate(scene, view)
    digest = hashlib.sha256(json.dumps(estimator.identity(), sort_keys=True).encode())
    digest.update(f"{scene.fingerprint}/{view.name}/{view.camera.width}x{view.camera.height}".encode())
    digest.update(np.ascontiguousarray(view.thermal).tobytes())
    path = cache / f"{digest.hexdigest()[:32]}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return DepthPrior(stored["values"], str(stored["kind"]))  # type: ignore[arg-type]
    prior = estimator.estimate(scene, view)
    cache.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        np.savez_compressed(part, values=prior.values, kind=prior.kind)
    return prior
