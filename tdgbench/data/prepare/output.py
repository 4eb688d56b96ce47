"""Write a scene in the RGBT-Scenes layout: rgb/, thermal/, masks/, sparse/0, temperature.json."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.data.prepare.report import Report
from tdgbench.scenes import Camera, PointCloud
from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.temperature import FILE, robust_range

SAMPLES = 4096  # temperatures that are kept of each view for the percentiles
NARROWEST = 0.01  # °C, of a range


class SceneWriter:
    """A writer of views, one by one, then of what concerns them all.

    is_celsius: thermal images hold °C and are written as float TIFF; else values in [0, 1], as 16-bit gray or 8-bit
    colour PNG.
    """

    def __init__(self, folder: Path, is_celsius: bool) -> None:
        self.folder, self.is_celsius = folder, is_celsius
        self.names: list[str] = []  # of the views
        self._samples: list[np.ndarray] = []  # of the views' temperatures
        for name in ("rgb", "thermal"):
            (folder / name).mkdir()

    def view(self, name: str, rgb: np.ndarray, thermal: np.ndarray, valid: np.ndarray) -> None:
        """Write a view. rgb: (H, W, 3) in [0, 1]. thermal: (H, W) °C or (H, W, C) in [0, 1]. valid: (H, W) bool.

        A mask is written where a pixel is invalid: 255 for measured pixels, else 0.
        """
        self.names.append(name)
        Image.fromarray(np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)).save(self.folder / "rgb" / f"{name}.png")
        self._thermal(name, thermal, valid)
        if not valid.all():
            (self.folder / "masks").mkdir(exist_ok=True)
            Image.fromarray(valid.astype(np.uint8) * 255).save(self.folder / "masks" / f"{name}.png")

    def _thermal(self, name: str, thermal: np.ndarray, valid: np.ndarray) -> None:
        if self.is_celsius:
            tiff = self.folder / "thermal" / f"{name}.tiff"
            Image.fromarray(thermal.astype(np.float32)).save(tiff, compression="tiff_deflate")
            measured = thermal[valid]
            self._samples.append(measured[:: max(1, len(measured) // SAMPLES)])
        else:
            is_gray = thermal.shape[2] == 1
            levels = np.round(np.clip(thermal, 0, 1) * (65535 if is_gray else 255))
            image = levels[..., 0].astype(np.uint16) if is_gray else levels.astype(np.uint8)
            Image.fromarray(image).save(self.folder / "thermal" / f"{name}.png")

    def temperature(self, given: tuple[float, float] | None, report: Report) -> None:
        """Write temperature.json: the given range, else one from the views, if one is known; report it."""
        if given is None and not self.is_celsius:
            return
        share = None
        if self.is_celsius:
            samples = np.concatenate(self._samples)
            if given is None:
                given = _range_of(samples)
            share = float(np.mean((samples < given[0]) | (samples > given[1])))
        assert given is not None
        content = {"unit": "degC", "min": given[0], "max": given[1]}
        (self.folder / FILE).write_text(json.dumps(content) + "\n", encoding="utf-8")
        report.temperature, report.clipped = given, share

    def model(self, cameras: dict[str, Camera], points: PointCloud) -> None:
        """Write the COLMAP model of the views, by image file."""
        write_model(self.folder / "sparse" / "0", list(cameras.items()), points)


def _range_of(samples: np.ndarray) -> tuple[float, float]:
    """Return the range of image values 0 and 1, in °C: robust, and never empty."""
    try:
        span = robust_range([samples])
        return span.min, span.max
    except ValueError:  # nearly all are equal
        low = float(np.median(samples))
        return low, low + NARROWEST
