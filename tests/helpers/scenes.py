"""Small synthetic scenes."""

from __future__ import annotations

from pathlib import Path

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import SyntheticDataset


def small_dataset(root: Path, **options) -> SyntheticDataset:
    return SyntheticDataset(str(root), ReadOptions(**options), width=48, height=36, views=10, points=300, seed=0)
