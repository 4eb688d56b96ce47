"""Options of reading a scene, and how results identify it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

WIDEST = 16384  # px, of resized images

FolderPath = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]+$")]  # of a data set; no control characters
Contrast = Literal["none", "percentile", "sequence", "clahe", "bbhe", "cdf"]  # `tdgbench.thermal.contrast`
DegC = Annotated[float, Field(ge=-273.15, le=1e5)]


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading a scene, in every layout.

    split: one of splits.SPLITS. width: of the resized images, px; None keeps their size. channels: of the thermal
    images: 1, 3 or "auto" (1 if all are gray). skip_unpaired: omit posed views without a thermal image, with a note,
    as the authors' loaders do; else they are an error. thermal: `shown` reads the layout's thermal images;
    `radiometric` takes °C from the cameras' files in raw_images/. principal_point: as in the model, or at the image's
    `center`, as 3DGS's and ThermalGaussian's readers assume. temperature: °C of image values 0 and 1; None takes them
    from the scene's files. fillers: values of pixels that were not measured, °C or counts; None finds them.
    """

    split: Literal["eighty_twenty", "every_8th", "folder"] = "eighty_twenty"
    width: Annotated[int, Field(ge=1, le=WIDEST)] | None = None
    channels: Literal["auto", 1, 3] = "auto"
    skip_unpaired: bool = True
    thermal: Literal["shown", "radiometric"] = "shown"
    principal_point: Literal["model", "center"] = "model"
    temperature: Annotated[list[DegC], Field(min_length=2, max_length=2)] | None = None
    fillers: list[float] | None = None


@dataclass(frozen=True)
class Description:
    """How results identify a scene."""

    scene: str
    dataset: str
    group: str  # a key of registry.GROUPS, or empty
