"""Depth maps from files, one per view: .npy, or 8- or 16-bit .png in which 0 means unknown."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from tdgbench.priors.prior import DepthPrior, Kind, PriorError
from tdgbench.scenes import Scene, SceneError, View
from tdgbench.scenes.formats import decode, header
from tdgbench.scenes.inputs import hash_of, is_there, read_array
from tdgbench.text import named

OFFER = "prior.estimator.folder=DIR (maps made elsewhere)"
RELEASED_FOLDER = "depthesti"  # folder of TDg's released code, inside the scene
MOST_SAID = 20  # causes that one message names
LARGEST_COUNT = {"8-bit": 255, "16-bit": 65535}


class FilePrior:
    """First existing file of <folder>/[<scene>/][train/|test/]<view>.{npy,png}.

    folder: None means `depthesti` in the scene's folder, as in TDg's release (TDg.py, lines 70 to 99). As there, a PNG
    is first resized bilinearly to the image's size; zeros then become unknown. An array of another size is resized by
    the means of its known values. A map has the aspect ratio of its image. kind: of the values, see DepthPrior.
    """

    def __init__(self, folder: str | None, kind: Kind) -> None:
        self.folder = None if folder is None else Path(folder)
        self.kind = kind

    def identity(self, scene: Scene) -> dict[str, object]:
        """Return what the maps depend on. Raises PriorError of all maps that cannot be used, each cause once."""
        folder = f"<scene>/{RELEASED_FOLDER}" if self.folder is None else str(self.folder)
        if self.folder is not None and not is_there(self.folder):
            raise PriorError(f"{folder} does not exist; prior.estimator.folder=DIR names the folder of the maps")
        digest, problems = hashlib.sha256(), dict[str, tuple[str, list[str]]]()
        for view in scene.train:
            try:
                with _as_prior_error():
                    digest.update(hash_of(self._find(scene, view)))
                self.estimate(scene, view)
            except PriorError as error:
                cause = re.sub(rf"\b{re.escape(view.name)}\b", "", str(error))
                problems.setdefault(cause, (str(error), []))[1].append(view.name)
        if problems:
            lines = [
                text + f" (so it is of {len(others)} more: {named(others)})" * bool(others)
                for text, (_, *others) in problems.values()
            ]
            count, more = sum(len(views) for _, views in problems.values()), len(lines) - MOST_SAID
            text = "\n  ".join([*lines[:MOST_SAID], *[f"and {more} more"] * (more > 0)])
            raise PriorError(f"{count} of {len(scene.train)} training views have no map to use: {text}")
        return {"estimator": "files", "folder": folder, "kind": self.kind, "files": digest.hexdigest()[:16]}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        path, (width, height) = self._find(scene, view), (view.camera.width, view.camera.height)
        with _as_prior_error():
            is_array = path.suffix == ".npy"
            if not is_array and self.kind == "metric":
                what = "kind=metric is z in the scene's units, and a picture has levels: save .npy"
                raise PriorError(f"{path}: {what}")
            values = read_array(path).astype(np.float32).squeeze() if is_array else _read_png(path)
            if values.ndim != 2:
                raise PriorError(f"{path} has shape {values.shape}; a depth map is (H, W)")
            _check_size(path, values, view)
        if is_array:
            return _usable(path, DepthPrior(values, self.kind).resized(width, height))
        if values.shape != (height, width):
            given = torch.from_numpy(values)[None, None]
            resized = torch.nn.functional.interpolate(given, (height, width), mode="bilinear", align_corners=False)
            values = resized[0, 0].numpy()
        return _usable(path, DepthPrior(np.where(values > 0, values, np.float32(np.nan)), self.kind))

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
            expected = " or ".join(str(base / f"{view.name}.npy") for base in bases)
            raise PriorError(
                f"view {view.name} has no depth prior; expected {expected} (or .png, or in train/ or test/); "
                "prior.estimator.folder=DIR names another folder"
            )
        return path


def _usable(path: Path, prior: DepthPrior) -> DepthPrior:
    """Return a map. Raises PriorError for one that says nothing of depth."""
    known = prior.values[np.isfinite(prior.values)]
    fault = ""
    if not known.size:
        fault = "has no known value: each is NaN, infinite or, of a picture, 0"
    elif not np.ptp(known):
        fault = f"has one value only, {known[0]:g}"
    elif prior.kind == "metric" and known.max() <= 0:
        fault = "has no value above 0, and kind=metric is z in the scene's units"
    if fault:
        raise PriorError(f"{path} {fault}; make it again")
    return prior


def _check_size(path: Path, values: np.ndarray, view: View) -> None:
    """Raise PriorError for a map (H, W) that cannot be of the view's image, which may have another size."""
    (height, width), camera = values.shape, view.camera
    if abs(width * camera.height - height * camera.width) > max(width, height):  # a pixel of rounding
        raise PriorError(
            f"{path} is {width}×{height} px and the image of view {view.name} {camera.width}×{camera.height} px: their "
            "aspect ratios differ, so it is no map of this image; make it again"
        )
    if not view.is_undistorted or (width, height) == (camera.width, camera.height) or view.thermal_path is None:
        return
    if (width, height) == header(view.thermal_path, as_picture=True)[1:3]:
        raise PriorError(
            f"{path} has the size of {view.thermal_path.name}, whose lens distortion is removed as it is read: "
            "make maps of undistorted images, as tdgbench data export SCENE OUT --format 3dgs writes them"
        )


@contextmanager
def _as_prior_error() -> Iterator[None]:
    """Turn what an unusable file raises into PriorError."""
    try:
        yield
    except SceneError as error:
        raise PriorError(str(error)) from error


def _read_png(path: Path) -> np.ndarray:
    """Read a depth map (H, W) float32 in [0, 1], 0 where unknown. Raises SceneError or PriorError."""
    decoded = decode(path, as_picture=True)
    values, depth = decoded.values, decoded.header.depth
    if values.shape[2] != 1 or depth not in LARGEST_COUNT or decoded.valid is not None:
        raise PriorError(
            f"{path} cannot be read as a depth map: it has {values.shape[2]} channels of {depth}, and "
            f"{'transparent' if decoded.valid is not None else 'no transparent'} pixels; a depth map has one channel "
            "of 8 or 16 bits"
        )
    return values[..., 0].astype(np.float32) / np.float32(LARGEST_COUNT[depth])
