"""Small synthetic scenes."""

from __future__ import annotations

from pathlib import Path

from tdgbench.scenes import FolderDataset, ReadOptions, Scene
from tdgbench.scenes.synthetic import SyntheticDataset


def load(folder: Path, layout: str | None = None, **options) -> Scene:
    """Load the scene in a folder. layout: of the data set; by default it is detected."""
    return FolderDataset(str(folder), ReadOptions(**options), layout).load(None)


def small_dataset(root: Path, **options) -> SyntheticDataset:
    return SyntheticDataset(str(root), ReadOptions(**options), width=48, height=36, views=10, points=300, seed=0)
