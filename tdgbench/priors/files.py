"""Depth maps from files, one per view: .npy, or 8- or 16-bit .png in which 0 means unknown."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from tdgbench.priors.prior import DepthPrior, Kind, PriorError
from tdgbench.scenes import Scene, SceneError, View
from tdgbench.scenes.formats import decode
from tdgbench.scenes.inputs import hash_of, is_there, read_array

OFFER = "prior.estimator.folder=DIR (maps made elsewhere)"
RELEASED_FOLDER = "depthesti"  # folder of TDg's released code, inside the scene
LARGEST_COUNT = {"8-bit": 255, "16-bit": 65535}


class FilePrior:
    """First existing file of <folder>/[<scene>/][train/|test/]<view>.{npy,png}.

    folder: None means `depthesti` in the scene's folder, as in TDg's release (TDg.py, lines 70 to 99). As there, a PNG
    is first resized bilinearly to the image's size; zeros then become unknown. An array of another size is resized by
    the means of its known values. kind: of the values, see DepthPrior.
    """

    def __init__(self, folder: str | None, kind: Kind) -> None:
        self.folder = None if folder is None else Path(folder)
        self.kind = kind

    def identity(self, scene: Scene) -> dict[str, object]:
        folder = f"<scene>/{RELEASED_FOLDER}" if self.folder is None else str(self.folder)
        digest = hashlib.sha256()
        for view in scene.train:
            with _as_prior_error():
                digest.update(hash_of(self._find(scene, view)))
        return {"estimator": "files", "folder": folder, "kind": self.kind, "files": digest.hexdigest()[:16]}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        path, (width, height) = self._find(scene, view), (view.camera.width, view.camera.height)
        with _as_prior_error():
            if path.suffix != ".npy":
                return DepthPrior(_read_png(path, (height, width)), self.kind)
            values = read_array(path).astype(np.float32).squeeze()
        if values.ndim != 2:
            raise PriorError(f"{path} has shape {values.shape}; a depth map is (H, W)")
        return DepthPrior(values, self.kind).resized(width, height)

    def _find(self, scene: Scene, view: View) -> Path:
        if self.folder is not None:
            bases = [self.folder / scene.name, self.folder]
        elif scene.folder is not None:
            bases = [scene.folder / RELEASED_FOLDER]
        else:
            raise PriorError(f"scene {scene.name} is not on disk; name the folder: prior.estimator.folder=DIR")
        candidates = [
            base / part / f"{view.name}{suffix}"
            for base in bases
            for part in ("train", "test", "")
            for suffix in (".npy", ".png")
        ]
        path = next((p for p in candidates if is_there(p)), None)
        if path is None:
            expected = bases[0] / f"{view.name}.npy"
            raise PriorError(
                f"view {view.name} has no depth prior; expected {expected} (or .png, or in train/ or test/)"
            )
        return path


@contextmanager
def _as_prior_error() -> Iterator[None]:
    """Turn what an unusable file raises into PriorError."""
    try:
        yield
    except SceneError as error:
        raise PriorError(str(error)) from error


def _read_png(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read a depth map (H, W) float32 in [0, 1], NaN where unknown. Raises SceneError or PriorError."""
    decoded = decode(path, as_picture=True)
    values, depth = decoded.values, decoded.header.depth
    if values.shape[2] != 1 or depth not in LARGEST_COUNT or decoded.valid is not None:
        raise PriorError(
            f"{path} cannot be read as a depth map: it has {values.shape[2]} channels of {depth}, and "
            f"{'transparent' if decoded.valid is not None else 'no transparent'} pixels; a depth map has one channel "
            "of 8 or 16 bits"
        )
    counts = values[..., 0].astype(np.float32) / np.float32(LARGEST_COUNT[depth])
    if counts.shape != size:
        given = torch.from_numpy(counts)[None, None]
        resized = torch.nn.functional.interpolate(given, size=size, mode="bilinear", align_corners=False)
        counts = resized[0, 0].numpy()
    return np.where(counts > 0, counts, np.float32(np.nan))
