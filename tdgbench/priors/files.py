"""Priors made elsewhere, one file per view: .npy, or .png of 8 or 16 bits in which 0 means unknown."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tdgbench.priors.prior import DepthPrior, Kind, PriorError
from tdgbench.scenes import Scene, View

BESIDE_THE_SCENE = "depthesti"  # where TDg's released code looks, in the scene's folder
BITS = {"L": 255, "I;16": 65535, "I": 65535}  # Pillow's modes: largest count


class FilePrior:
    """Reads the first of <folder>/[<scene>/][train/|test/]<view>.{npy,png}.

    folder: None for `depthesti` in the scene's own folder, as TDg's release (TDg.py, lines 70 to 99). A PNG of another
    size than the images is resized bilinearly before zeros are taken as unknown, as there.
    """

    def __init__(self, folder: str | None, kind: Kind) -> None:
        self.folder = None if folder is None else Path(folder)
        self.kind = kind

    def identity(self, scene: Scene) -> dict[str, object]:
        folder = f"<scene>/{BESIDE_THE_SCENE}" if self.folder is None else str(self.folder)
        digest = hashlib.sha256()
        for view in scene.train:
            digest.update(hashlib.sha256(self._find(scene, view).read_bytes()).digest())
        return {"estimator": "files", "folder": folder, "kind": self.kind, "files": digest.hexdigest()[:16]}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        path = self._find(scene, view)
        try:
            if path.suffix == ".npy":
                values = np.load(path, allow_pickle=False).astype(np.float32).squeeze()
            else:
                values = _read_png(path, (view.camera.height, view.camera.width))
        except (OSError, ValueError) as error:
            raise PriorError(f"{path} cannot be read as a depth map: {error}") from error
        return DepthPrior(values, self.kind)

    def _find(self, scene: Scene, view: View) -> Path:
        if self.folder is not None:
            bases = [self.folder / scene.name, self.folder]
        elif scene.folder is not None:
            bases = [scene.folder / BESIDE_THE_SCENE]
        else:
            raise PriorError(f"scene {scene.name} is not on disk; name the folder: prior.estimator.folder=DIR")
        candidates = [
            base / part / f"{view.name}{suffix}"
            for base in bases
            for part in ("train", "test", "")
            for suffix in (".npy", ".png")
        ]
        path = next((p for p in candidates if p.exists()), None)
        if path is None:
            expected = bases[0] / f"{view.name}.npy"
            raise PriorError(
                f"view {view.name} has no depth prior; expected {expected} (or .png, or in train/ or test/)"
            )
        return path


def _read_png(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H, W) float32 in [0, 1] at a size, NaN where unknown. Raises ValueError for a picture that is no depth map."""
    with Image.open(path) as image:
        if image.mode not in BITS:
            raise ValueError(f"it has mode {image.mode}; a depth map has one channel of 8 or 16 bits")
        counts = np.asarray(image).astype(np.float32) / np.float32(BITS[image.mode])
    if counts.shape != size:
        given = torch.from_numpy(counts)[None, None]
        resized = torch.nn.functional.interpolate(given, size=size, mode="bilinear", align_corners=False)
        counts = resized[0, 0].numpy()
    return np.where(counts > 0, counts, np.float32(np.nan))
