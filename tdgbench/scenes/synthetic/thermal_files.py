"""Thermal files of a made scene: 8 bits of the world's range, float TIFF in °C, or 8 bits of each image's own range."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from tdgbench.scenes.synthetic.thermal_camera import Encoding, TrueCamera, limits
from tdgbench.scenes.synthetic.world import World
from tdgbench.scenes.temperature import FILE

PALETTE = "inferno"


class ThermalFiles:
    """Writes thermal/ and temperature.json of a scene, view by view.

    With °C, the range in temperature.json is the world's, widened to all values that the camera shows. With automatic
    gain control there is none.
    """

    def __init__(self, folder: Path, world: World, encoding: Encoding) -> None:
        self.folder, self.world, self.encoding = folder, world, encoding
        self.low, self.high = world.temperatures
        self.limits: list[tuple[float, float]] = []
        (folder / "thermal").mkdir()

    def view(self, name: str, degC: np.ndarray) -> None:
        """Write what the camera shows, (H, W) in °C."""
        if self.encoding == "degC":
            self.low, self.high = min(self.low, math.floor(degC.min())), max(self.high, math.ceil(degC.max()))
            tiff = self.folder / "thermal" / f"{name}.tiff"
            Image.fromarray(degC.astype(np.float32)).save(tiff, compression="tiff_deflate")
            return
        image = thermal_image(degC, self.world)
        if self.encoding == "agc":
            self.limits.append(limits(degC))
            image = levels(degC, *self.limits[-1])
        Image.fromarray(image).save(self.folder / "thermal" / f"{name}.png")

    def finish(self, camera: TrueCamera) -> TrueCamera:
        """Write temperature.json; return the camera with the limits of its gain control."""
        if self.encoding == "agc":
            return replace(camera, limits=np.array(self.limits))
        content = {"unit": "degC", "min": self.low, "max": self.high}
        (self.folder / FILE).write_text(json.dumps(content), encoding="utf-8")
        return camera


def thermal_image(degC: np.ndarray, world: World) -> np.ndarray:
    """8-bit image (H, W) or (H, W, 3) of temperatures (H, W) in °C."""
    level = levels(degC, *world.temperatures)
    if not world.pseudo_color:
        return level
    palette = np.round(matplotlib.colormaps[PALETTE](np.arange(256))[:, :3] * 255).astype(np.uint8)
    return palette[level]


def levels(degC: np.ndarray, low: float, high: float) -> np.ndarray:
    """8-bit values (H, W) of temperatures (H, W), 0 and 255 for `low` and `high`.

    >>> levels(np.array([[9.0, 10.0, 15.0, 30.0]]), 10, 20)
    array([[  0,   0, 128, 255]], dtype=uint8)
    """
    return np.round(((degC - low) / (high - low)).clip(0, 1) * 255).astype(np.uint8)
