"""Priors made elsewhere: DIR/<view>.npy, or 16-bit DIR/<view>.png; one folder per scene, or one for all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.priors.prior import DepthPrior, Kind, PriorError
from tdgbench.scenes import Scene, View


class FilePrior:
    """Reads <folder>/<scene>/<view>.{npy,png} or <folder>/<view>.{npy,png}; zeros in a PNG mean unknown."""

    def __init__(self, folder: str, kind: Kind) -> None:
        self.folder = Path(folder)
        self.kind = kind

    def identity(self) -> dict[str, object]:
        return {"estimator": "files", "folder": str(self.folder), "kind": self.kind}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        candidates = [
            base / f"{view.name}{suffix}"
            for base in (self.folder / scene.name, self.folder)
            for suffix in (".npy", ".png")
        ]
        path = next((p for p in candidates if p.exists()), None)
        if path is None:
            raise PriorError(f"view {view.name} has no depth prior; expected {candidates[0]} (or .png)")
        try:
            if path.suffix == ".npy":
                values = np.load(path, allow_pickle=False).astype(np.float32).squeeze()
            else:
                with Image.open(path) as image:
                    counts = np.asarray(image).astype(np.float32)
                values = np.where(counts > 0, counts / np.float32(65535), np.float32(np.nan))
        except (OSError, ValueError) as error:
            raise PriorError(f"{path} cannot be read as a depth map: {error}") from error
        return DepthPrior(values, self.kind)
