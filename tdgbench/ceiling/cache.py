"""A scene's ceiling is estimated once: it is kept on disk by what it is made from."""

from __future__ import annotations

import hashlib
import json
import logging
from functools import cache
from pathlib import Path

import numpy as np

from tdgbench.ceiling.ceiling import Ceiling, Unknown, ceiling
from tdgbench.files import whole_file
from tdgbench.scenes import Scene
from tdgbench.scenes.inputs import is_there

LOG = logging.getLogger(__name__)


def cached_ceiling(scene: Scene, folder: Path | None) -> Ceiling | Unknown:
    """The ceiling of a scene, from `folder` if it is there; None disables that.

    A file's name is a hash of the training views' images, masks and cameras, of the points, and of this package.
    """
    if folder is None:
        return ceiling(scene)
    path = folder / f"{_identity(scene)}.json"
    stored = _read(path) if is_there(path) else None
    if stored is not None:
        return stored
    found = ceiling(scene)
    with whole_file(path) as part:
        part.write_text(json.dumps(found._asdict()), encoding="utf-8")
    return found


def _identity(scene: Scene) -> str:
    digest = hashlib.sha256(_sources())
    for view in scene.train:
        camera = view.camera
        for array in (view.thermal, view.valid, camera.K, camera.world_to_camera):
            digest.update(b"" if array is None else f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    if scene.points is not None:
        digest.update(np.ascontiguousarray(scene.points.points).tobytes())
    return digest.hexdigest()[:32]


@cache
def _sources() -> bytes:
    return b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))


def _read(path: Path) -> Ceiling | Unknown | None:
    """A stored ceiling; None, and a warning, for a file that holds none."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if set(stored) == set(Unknown._fields):
            return Unknown(str(stored["reason"]))
        return Ceiling(**{name: float(stored[name]) for name in Ceiling._fields})
    except (OSError, ValueError, TypeError, KeyError) as error:
        LOG.warning("the cached ceiling %s is damaged and made again: %s", path, error)
        return None
