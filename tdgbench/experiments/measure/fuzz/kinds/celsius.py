"""Arrays of temperatures, as ThermalMix has them: `warped_thermal/<view>.npy`."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.experiments.measure.fuzz.case import Change
from tdgbench.experiments.measure.fuzz.colmap.model import MalformedError
from tdgbench.experiments.measure.fuzz.damage import damage
from tdgbench.experiments.measure.fuzz.inputs import TEMPERATURES
from tdgbench.experiments.measure.fuzz.kinds.depth import ARRAYS
from tdgbench.experiments.measure.fuzz.kinds.scene import SceneKind
from tdgbench.experiments.measure.fuzz.strict import read_npy

TOLERANCE = 1e-5  # of image values, which are in [0, 1]


class Celsius(SceneKind):
    """Temperatures in °C: damaged bytes, other arrays, unusual numbers, missing files."""

    name, share, words = "celsius", 6, ("method=splat",)

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
