"""Apply the estimated response of a thermal camera to renders of a model that was trained on corrected views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter, with_config

from tdgbench.thermal.maps import TERMS, evaluate


@with_config(ConfigDict(extra="forbid", allow_inf_nan=False))
@dataclass(frozen=True)
class ImageResponse:
    """Response of a camera in image values, and the range of the images that a model was trained on.

    shown = T + (gain − 1) (T − reference) + offset + vignette(x, y), T = low + (high − low) · render.
    offsets, gains: by view. Test views are not read: their offset is interpolated in the sequence, their gain is 1.
    vignette: (K,) coefficients of `maps`.
    """

    reference: float = 0.0
    offsets: Mapping[str, float] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    vignette: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        if len(self.vignette) not in (0, len(TERMS)):
            raise ValueError(f"the vignette of a response has {len(self.vignette)} coefficients, not {len(TERMS)}")
        if not self.low < self.high:
            raise ValueError(f"the range of a response ends at {self.high:g}, not above {self.low:g}")

    def temperatures(self, render: np.ndarray) -> np.ndarray:
        """Return the image (H, W, C) float32 of a render by an ideal camera, not clipped."""
        if (self.low, self.high) == (0.0, 1.0):
            return render
        return np.asarray(self.low + (self.high - self.low) * render, np.float32)

    def shown(self, render: np.ndarray, view: str) -> np.ndarray:
        """Return the image (H, W, C) float32 of a render of a view by this camera, not clipped."""
        values = self.temperatures(render)
        if self.is_ideal:
            return values
        gain = self.gains.get(view, 1.0)
        added = np.full(values.shape[:2], self.offsets.get(view, 0.0) + (1 - gain) * self.reference)
        if self.vignette:
            added += evaluate(np.array(self.vignette), *values.shape[1::-1])
        return np.asarray(gain * values + added[..., None], np.float32)

    @property
    def is_ideal(self) -> bool:
        """Whether the camera has no response of its own."""
        return not (self.offsets or self.gains or self.vignette)

    def as_json(self) -> dict[str, Any]:
        """Return the fields for a record, without empty ones."""
        return {name: value for name, value in asdict(self).items() if value not in ((), {})}


IDEAL = ImageResponse()


def read_response(stated: Mapping[str, Any] | None) -> ImageResponse:
    """Return the response in a record, by default an ideal camera's. Raises ValueError for invalid fields."""
    return TypeAdapter(ImageResponse).validate_python({} if stated is None else stated)
