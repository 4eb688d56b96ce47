"""Poses that other programs found: read them, compare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from tdgbench.scenes import PointCloud
from tdgbench.scenes.colmap.tables import CameraEntry


class Reference(NamedTuple):
    """What another program found. poses: world to camera (4, 4) in OpenCV axes, by view name.

    lenses: none if they are not stated; raises SceneError for one that COLMAP cannot say.
    """

    poses: dict[str, np.ndarray]
    lenses: Callable[..., list[CameraEntry]] = list  # all, or those of given ids
    points: PointCloud | None = None
    lens_ids: Mapping[str, int] = MappingProxyType({})  # of each view's lens, where the file says it
    notes: Sequence[str] = ()  # on what the file holds beside
