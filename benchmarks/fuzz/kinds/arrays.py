"""Numbers beside the images of a scene: temperatures in °C, their range, and depth maps."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.fuzz.case import Change
from benchmarks.fuzz.colmap_model import MalformedError
from benchmarks.fuzz.inputs import SIZE, TEMPERATURES, TRAIN
from benchmarks.fuzz.kinds.scene import SceneKind
from benchmarks.fuzz.mutations import damage, edit
from benchmarks.fuzz.strict import png_problem, read_npy, read_temperatures
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


TOLERANCE = 1e-5  # of image values, which are in [0, 1]


class Celsius(SceneKind):
    """Temperatures in °C: damaged bytes, other arrays, unusual numbers, missing files."""

    name, share, words = "celsius", 6, ("method=3dgs",)

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.arrays = self.scene / "warped_thermal"
        self.arrays.mkdir()
        for path in sorted((self.scene / "thermal").iterdir()):
            levels = np.asarray(Image.open(path), np.float32)
            np.save(self.arrays / f"{path.stem}.npy", 10 + levels / 10)
        shutil.rmtree(self.scene / "thermal")
        if rng.random() < 0.7:
            (self.scene / "temperature.json").unlink()

    def mutate(self, rng: random.Random) -> Change:
        path = rng.choice(sorted(self.arrays.iterdir()))
        names, how = (path.name, path.stem, self.arrays.name), rng.random()
        if how < 0.05:
            path.unlink()
            return Change(f"{path.name}: deleted", names)
        if how < 0.3:
            values = rng.choice(ARRAYS)()
            np.save(path, values)
            return Change(f"{path.name}: {values.dtype} {values.shape}", names)
        if how < 0.6:
            values, value = np.load(path), rng.choice((np.nan, np.inf, -np.inf, 0.0, -300.0, 1e30, 655.35, 1000.0))
            if rng.random() < 0.5:
                values[:, : rng.randrange(1, 8)] = value
            else:
                values[rng.randrange(values.shape[0]), rng.randrange(values.shape[1])] = value
            np.save(path, values)
            return Change(f"{path.name}: some are {value}", names)
        data, what = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return Change(f"{path.name}: {what}", names)

    def wrong_on_disk(self) -> str:
        for path in sorted(self.arrays.iterdir()):
            try:
                read_npy(path)
            except MalformedError as error:
                return f"a result in spite of a damaged {error}"
        return ""

    def wrong_values(self, found: dict) -> str:
        why = self.wrong_on_disk()
        if why:
            return why
        low, high = found["temperature"].tolist()
        has_counts = (self.scene / "temperature.json").exists()
        for name in found["names"].tolist():
            with np.errstate(all="ignore"):
                values = read_npy(self.arrays / f"{name}.npy").squeeze()
                scale = TEMPERATURES["degC_per_count"] if has_counts and values.dtype.kind in "iu" else 1
                degC = values.astype(np.float64) * scale
                expected = np.clip((degC - low) / (high - low), 0, 1)
            image, valid = found[f"thermal/{name}"][..., 0], np.broadcast_to(found[f"valid/{name}"], degC.shape)
            if image.shape != degC.shape or not np.isfinite(degC[valid]).all():
                return f"{name} is {image.shape} of {degC.shape}, or values that are not finite count as measured"
            if np.abs(image - expected)[valid].max() > TOLERANCE or image[~valid].any():
                return f"{name} differs from its file"
        return ""


class Temperature(SceneKind):
    """The range of temperatures: damaged bytes, edited text, other content."""

    name, share = "temperature", 5

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        self.thermal = rng.choice(("png16", "tif16", "tif32"))
        super().__init__(base, folder, rng)
        self.file = self.scene / "temperature.json"

    def mutate(self, rng: random.Random) -> Change:
        how, names = rng.random(), (self.file.name,)
        if how < 0.05 and self.file.exists():
            self.file.unlink()
            return Change("temperature.json: deleted", (*names, "view"))
        old = self.file.read_bytes() if self.file.exists() else b"{}"
        if how < 0.3:
            data, what = damage(old, rng)
        elif how < 0.8:
            data, what = edit(old.decode(errors="replace"), rng)
        else:
            data = rng.choice(CONTENTS)
            what = f"holds {data[:40]!r}"
        self.file.write_bytes(data)
        return Change(f"temperature.json: {what}", names)

    def wrong_on_disk(self) -> str:
        try:
            if self.file.exists():
                read_temperatures(self.file)
        except MalformedError as error:
            return f"a result in spite of {error}"
        return ""

    def wrong_values(self, found: dict) -> str:
        why = self.wrong_on_disk()
        if why or not self.file.exists():
            return why
        low_high = found["temperature"].tolist()
        return "" if low_high == read_temperatures(self.file) else f"loaded {low_high}"


CONTENTS = (
    b"", b"null", b"[]", b"3", b'"min"', b"{}", b'{"min": 0}', b'{"min": 5, "max": 5}', b'{"min": 40, "max": 0}',
    b'{"min": NaN, "max": 40}', b'{"min": -Infinity, "max": 40}', b'{"min": 0, "max": Infinity}',
    b'{"min": 0, "max": 1e400}', b'{"min": "0", "max": "x"}', b'{"min": [0], "max": {}}', b'{"min": true, "max": null}',
    b'{"min": 0, "max": 40, "degC_per_count": NaN}', b'{"min": 0, "max": 40, "degC_per_count": "a"}',
    b'{"min": 0, "max": 40, "degC_per_count": 0.001, "degC_at_zero": Infinity}', b"[" * 100_000,
    b'{"min": 0, "max": ' + b"9" * 5000 + b"}", b'{"min": 0, "max": 1e-320}', b'{"min": -1e308, "max": 1e308}',
)  # fmt: skip
