"""Depth priors from files: `depthesti/<view>.npy` and .png."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.experiments.measure.fuzz.case import Change
from tdgbench.experiments.measure.fuzz.colmap.model import MalformedError
from tdgbench.experiments.measure.fuzz.damage import damage
from tdgbench.experiments.measure.fuzz.inputs import SIZE, TRAIN
from tdgbench.experiments.measure.fuzz.kinds.scene import SceneKind
from tdgbench.experiments.measure.fuzz.strict import png_problem, read_npy
from tdgbench.priors import DepthEstimator
from tdgbench.priors.files import FilePrior


class Depth(SceneKind):
    """Depth maps of a scene: damaged bytes, other arrays, missing files."""

    name, share, words = "depth", 6, ("method=tdg", "prior=files")

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.maps = self.scene / "depthesti"
        if rng.random() < 0.3:
            for path in sorted(self.maps.iterdir()):
                counts = (np.load(path) * 10_000).astype(np.uint16)
                Image.fromarray(counts).save(path.with_suffix(".png"))
                path.unlink()

    def prior(self) -> DepthEstimator:
        return FilePrior(None, "depth")

    def mutate(self, rng: random.Random) -> Change:
        path = rng.choice(self._needed())
        names, how = (path.name, path.stem), rng.random()
        if how < 0.05:
            path.unlink()
            return Change(f"{path.name}: deleted", names)
        if how < 0.5 and path.suffix == ".npy":
            values = rng.choice(ARRAYS)()
            np.save(path, values)
            return Change(f"{path.name}: {values.dtype} {values.shape}", names)
        data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"{path.name}: {what}", names)

    def _needed(self) -> list[Path]:
        """Maps of training views; test views need none."""
        return [path for path in sorted(self.maps.iterdir()) if path.stem in TRAIN]

    def wrong_on_disk(self) -> str:
        for path in self._needed():
            if path.suffix == ".png" and png_problem(path.read_bytes()):
                return f"a result in spite of a damaged {path.name}: {png_problem(path.read_bytes())}"
            if path.suffix == ".npy":
                try:
                    values = read_npy(path)
                except MalformedError as error:
                    return f"a result in spite of a damaged {error}"
                if values.squeeze().shape != SIZE[::-1] or not np.isfinite(values.astype(float)).any():
                    return f"a result in spite of {path.name}: {values.dtype} {values.shape}"
        return ""

    def wrong_values(self, found: dict) -> str:
        why = self.wrong_on_disk()
        if why:
            return why
        for name in found["train"].tolist():
            path = self.maps / f"{name}.npy"
            if path.exists():
                with np.errstate(all="ignore"):
                    expected = read_npy(path).astype(np.float32).squeeze()
                if not np.array_equal(found[f"prior/{name}"], expected, equal_nan=True):
                    return f"the prior of {name} differs from its file"
        return ""


def _map(value: float = 2.0, kind: str = "f4", shape: tuple[int, ...] = (24, 32)) -> np.ndarray:
    values = np.full(shape, 2.0, kind)
    values.flat[:1] = value
    return values


ARRAYS = (
    lambda: _map(np.nan), lambda: _map(np.inf), lambda: _map(-1e38), lambda: _map() * np.nan, lambda: _map() * np.inf,
    lambda: _map() * 0, lambda: -_map(), lambda: _map(1e300, "f8"), lambda: _map(kind="f2"), lambda: _map(2, "i8"),
    lambda: _map(1, "?"), lambda: _map(kind="c8"), lambda: _map(shape=(32, 24)), lambda: _map(shape=(24, 32, 1)),
    lambda: _map(shape=(1, 24, 32)), lambda: _map(shape=(24, 32, 3)), lambda: _map(shape=(0, 32)),
    lambda: _map(shape=()),
    lambda: np.array([{"a": 1}], object), lambda: np.full((24, 32), "x"), lambda: np.zeros((24, 32), "V8"),
    lambda: np.zeros((24, 32), [("a", "f4")]), lambda: np.zeros((24, 32), "M8[s]"),
)  # fmt: skip
