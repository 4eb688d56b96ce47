"""Estimate the prior of every training view; cache the maps on disk by image and estimator."""

from __future__ import annotations

import hashlib
import json
import logging
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tdgbench.files import whole_file
from tdgbench.priors.prior import DepthEstimator, DepthPrior
from tdgbench.scenes import Scene, View
from tdgbench.scenes.inputs import is_there, regular_file

LOG = logging.getLogger(__name__)


def estimate_all(
    estimator: DepthEstimator, scene: Scene, cache: Path | None, report: Callable[[int, int], None] | None = None
) -> tuple[dict[str, DepthPrior], int]:
    """Return priors of the training views by name, and how many of them were not in the cache.

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
    """Return the prior of a view, and whether it is new."""
    if cache is None:
        return estimator.estimate(scene, view), True
    digest = hashlib.sha256(identity.encode())
    digest.update(f"{scene.fingerprint}/{view.name}/{view.camera.width}x{view.camera.height}".encode())
    digest.update(np.ascontiguousarray(view.thermal).tobytes())
    path = cache / f"{digest.hexdigest()[:32]}.npz"
    stored = _read(path, view) if is_there(path) else None
    if stored is not None:
        return stored, False
    prior = estimator.estimate(scene, view).check(view)
    cache.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        np.savez_compressed(part, values=prior.values, kind=prior.kind)
    return prior, True


def _read(path: Path, view: View) -> DepthPrior | None:
    """Return a stored prior; None, and a warning, for a file that is damaged: cut, changed, or of another shape.

    The archive holds checksums of its members, so changed bytes are found.
    """
    try:
        with zipfile.ZipFile(regular_file(path)) as archive:
            largest = 4 * view.camera.width * view.camera.height + 4096  # bytes; before a header's shape is believed
            if any(member.file_size > largest for member in archive.infolist()):
                raise ValueError("it is larger than a prior of its view")
        with np.load(path, allow_pickle=False) as stored:
            values, kind = stored["values"], str(stored["kind"])
        if values.dtype != np.float32:
            raise ValueError(f"it holds {values.dtype}")
        return DepthPrior(values, kind).check(view)  # type: ignore[arg-type]
    except MemoryError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds
        LOG.warning("the cached prior %s is damaged and made again: %s", path, error)
        return None
