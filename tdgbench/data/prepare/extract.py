"""Read the camera's files of a view: temperatures or shown thermal values, and the RGB image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tdgbench.data.prepare.sources import ViewFiles
from tdgbench.scenes import SceneError
from tdgbench.scenes.images import COUNT_MODES, read_image, whole_image
from tdgbench.scenes.inputs import regular_file
from tdgbench.scenes.radiometric import PhotoMapping, is_radiometric, read_celsius, read_thermogram
from tdgbench.scenes.temperature import Radiometry


@dataclass(frozen=True)
class CountScale:
    """The meaning of 16-bit counts: degC = counts × degC_per_count + degC_at_zero. None: they have none."""

    degC_per_count: float | None = None
    degC_at_zero: float = 0.0


@dataclass(frozen=True)
class Extracted:
    """Content of a view's files.

    thermal: (H, W) float64 °C with NaN where invalid; or (H, W, C) float32 in [0, 1] of shown images. rgb: (h, w, 3)
    float32 in [0, 1]. mapping: as a FLIR file states it, of its own photo. settings: of the camera, in words.
    """

    thermal: np.ndarray
    rgb: np.ndarray
    mapping: PhotoMapping | None = None
    settings: str = ""

    @property
    def is_celsius(self) -> bool:
        return self.thermal.ndim == 2

    @property
    def sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Width and height of RGB and of thermal."""
        return self.rgb.shape[1::-1], self.thermal.shape[1::-1]  # type: ignore[return-value]


def extract(files: ViewFiles, scale: CountScale) -> Extracted:
    """Read a view's files. Raises SceneError naming the file."""
    if files.rgb is None:
        thermogram = read_thermogram(files.thermal)
        if thermogram.photo is None:
            raise SceneError(f"{files.thermal} holds no photo; put an RGB image of the same name beside it")
        photo = thermogram.photo.astype(np.float32) / 255
        return Extracted(thermogram.celsius, photo, thermogram.mapping, _in_words(thermogram.settings))
    rgb = read_rgb(files.rgb)
    if holds_celsius(files.thermal, scale):
        return Extracted(read_celsius(files.thermal, scale.degC_per_count, scale.degC_at_zero), rgb)
    return Extracted(read_image(files.thermal), rgb)


def _in_words(settings: dict[str, float]) -> str:
    """Say what a FLIR file's temperatures were corrected with."""
    return (
        f"emissivity {settings['emissivity']:.2f}, distance {settings['object_distance']:g} m, reflected "
        f"{settings['reflected_apparent_temperature'] - 273.15:.1f} °C, window transmission "
        f"{settings['ir_window_transmission']:.2f}"
    )


def read_rgb(path: Path) -> np.ndarray:
    """Read an RGB image (H, W, 3), float32 in [0, 1]. Raises SceneError."""
    image = read_image(path)
    return np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image


def holds_celsius(path: Path, scale: CountScale) -> bool:
    """Return whether temperatures can be read from a thermal file; else it shows values without a scale."""
    if is_radiometric(regular_file(path)):
        return True
    with whole_image(path) as image:
        return image.mode in COUNT_MODES and scale.degC_per_count is not None


def count_scale(given: CountScale, radiometry: Radiometry | None) -> CountScale:
    """Return the scale of 16-bit counts: as given, else as the folder's temperature.json says."""
    if given.degC_per_count is not None or radiometry is None:
        return given
    return CountScale(radiometry.degC_per_count, radiometry.degC_at_zero)
