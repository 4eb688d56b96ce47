"""Estimate the prior of every training view; cache the maps on disk by image and estimator."""

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
) -> tuple[dict[str, DepthPrior], int]:
    """Priors of the training views by name, and how many of them were not in the cache.

    cache: folder of the maps; None disables it. report: called with (views done, views).
    """
    priors, made = {}, 0
    identity = json.dumps(estimator.identity(scene), sort_keys=True)
    for index, view in enumerate(scene.train, start=1):
        prior, is_new = _cached(estimator, identity, scene, view, cache)
        priors[view.name], made = prior.check(view), made + is_new
        if report is not None:
            report(index, len(scene.train))
    return priors, made


def _cached(
    estimator: DepthEstimator, identity: str, scene: Scene, view: View, cache: Path | None
) -> tuple[DepthPrior, bool]:
    """Prior of a view, and whether it is new."""
    if cache is None:
        return estimator.estimate(scene, view), True
    digest = hashlib.sha256(identity.encode())
    digest.update(f"{scene.fingerprint}/{view.name}/{view.camera.width}x{view.camera.height}".encode())
    digest.update(np.ascontiguousarray(view.thermal).tobytes())
    path = cache / f"{digest.hexdigest()[:32]}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return DepthPrior(stored["values"], str(stored["kind"])), False  # type: ignore[arg-type]
    prior = estimator.estimate(scene, view)
    cache.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        np.savez_compressed(part, values=prior.values, kind=prior.kind)
    return prior, True
