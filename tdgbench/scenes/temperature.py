"""Temperatures of image values: of `temperature.json`, of ThermoScenes' bounds, or a range of the temperatures."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_there, read_json
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.text import meant, shortened

FILE = "temperature.json"
KEYS = "min", "max"
OF_COUNTS = "degC_per_count", "degC_at_zero"
ALL_KEYS = *KEYS, "unit", *OF_COUNTS, "comment"
UNITS = "degc", "°c", "c", "celsius"
# Of ThermoScenes, in °C: Schindler-EPFL-Lab/thermo-nerf 08d9be9, thermo_scenes/flir_thermal_images/custom_flir.py.
BOUNDS_FILE = "temperature_bounds.json"
BOUNDS_KEYS = "absolute_min_temperature", "absolute_max_temperature"
TEMPERATURES = (-273.15, 1e5)  # °C; absolute zero, and beyond what cameras measure
PERCENTILES = (0.1, 99.9)  # of the training views' temperatures, which become image values 0 and 1
MOST_SAMPLES = 1_000_000  # temperatures that percentiles are computed of


@dataclass(frozen=True)
class CountScale:
    """The meaning of 16-bit counts: degC = counts × degC_per_count + degC_at_zero. None: it is not known."""

    degC_per_count: float | None = None
    degC_at_zero: float = 0.0

    @property
    def is_known(self) -> bool:
        return self.degC_per_count is not None

    def degC(self, counts: np.ndarray) -> np.ndarray:
        """Return the temperatures of counts, float64."""
        assert self.degC_per_count is not None
        return counts.astype(np.float64) * self.degC_per_count + self.degC_at_zero


@dataclass(frozen=True)
class Radiometry:
    """Temperatures of the image values 0 and 1, and of 16-bit counts."""

    range: TemperatureRange
    scale: CountScale = CountScale()


def temperature_file(folder: Path) -> Path:
    """Return the file that may state °C of image values: ThermoScenes' bounds, if they alone are there, else FILE.

    Raises SceneError where both are there and differ, and for a file that cannot be read.
    """
    found = [folder / name for name in (FILE, BOUNDS_FILE) if is_there(folder / name)]
    stated = {path: known.range for path in found if (known := read_radiometry(path)) is not None}
    spans = [(span.min, span.max) for span in stated.values()]
    if spans and not np.allclose(spans, spans[0], rtol=0, atol=0.05):  # °C: one may be rounded
        both = ", ".join(f"{path} states {span.min:g} to {span.max:g} °C" for path, span in stated.items())
        raise SceneError(f"{both}; remove the file that is wrong")
    return (found or [folder / FILE])[0]


def read_radiometry(path: Path) -> Radiometry | None:
    """Read `temperature.json` or BOUNDS_FILE; None if there is no such file. Raises SceneError.

    They hold the lowest and highest temperature in °C. degC_per_count and degC_at_zero are of 16-bit images.
    """
    if not is_there(path):
        return None
    lowest, highest = BOUNDS_KEYS if path.name == BOUNDS_FILE else KEYS
    try:
        content = read_json(path)
        if not isinstance(content, dict) or not {lowest, highest} <= content.keys():
            raise ValueError("it does not have both")
        for key in () if path.name == BOUNDS_FILE else content.keys() - {*ALL_KEYS}:
            said = f"it has the key {shortened(repr(key), 60)}, and may have {', '.join(ALL_KEYS)}"
            raise ValueError(said + meant(key, ALL_KEYS))
        if "degC_at_zero" in content and content.get("degC_per_count") is None:
            raise ValueError(f"{OF_COUNTS[1]} needs {OF_COUNTS[0]}")
        if str(unit := content.get("unit", "degC")).lower() not in UNITS:
            raise ValueError(f"its unit {shortened(repr(unit), 60)} is not degC")
        span = check_range(content[lowest], content[highest])
        per_count = content.get("degC_per_count")
        if per_count is not None and finite_number(per_count) == 0:
            raise ValueError("degC_per_count is 0")
        per_count = None if per_count is None else finite_number(per_count)
        return Radiometry(span, CountScale(per_count, finite_number(content.get("degC_at_zero", 0.0))))
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path} must hold finite numbers `{lowest}` < `{highest}` in °C: {error}") from error


def check_range(low: Any, high: Any) -> TemperatureRange:
    """Return the range of two finite numbers in °C, `low` below `high`. Raises ValueError."""
    low, high = finite_number(low), finite_number(high)
    if not TEMPERATURES[0] <= low < high <= TEMPERATURES[1]:
        raise ValueError(f"min {low} and max {high} are no range in {TEMPERATURES[0]} to {TEMPERATURES[1]:g}")
    return TemperatureRange(low, high)


def finite_number(value: object) -> float:
    """Return a finite number, also of its text. Raises ValueError."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (ValueError, TypeError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool):
        raise ValueError(f"{shortened(repr(value), 60)} is no finite number")
    return number


def sampled(values: np.ndarray, views: int) -> np.ndarray:
    """Return evenly spaced ones of a view's values (N,), so few that all `views` have MOST_SAMPLES at most.

    The step has no divisor in common with N, nor so with the width of an image, of which it would read few columns.

    >>> sampled(np.arange(9), views=250_000)
    array([0, 4, 8])
    """
    fewest = max(1, -(-len(values) * views // MOST_SAMPLES))
    return values[:: next(step for step in itertools.count(fewest) if math.gcd(step, max(len(values), 1)) == 1)]
