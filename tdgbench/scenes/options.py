"""Options of reading a scene, how its views are split, and how results identify it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import Field

WIDEST = 16384  # px, of resized images

Split = Literal["eighty_twenty", "every_8th", "folder"]
SPLITS: tuple[str, ...] = get_args(Split)
FolderPath = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]+$")]  # of a data set; no control characters
DegC = Annotated[float, Field(ge=-273.15, le=1e5)]


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading a scene, in every layout.

    split: into training and test views, by `split_names`. width: of the resized images, px; None keeps their size.
    channels: of the thermal images: 1, 3 or "auto" (1 if all are gray). thermal: `shown` reads the layout's thermal
    images; `radiometric` takes °C from the cameras' files in raw_images/. principal_point: as in the model, or at the
    image's `center`, as 3DGS's and ThermalGaussian's readers assume. temperature: °C of image values 0 and 1; None
    takes them from the scene's files. fillers: values of pixels that were not measured, °C or counts; None finds them.
    """

    split: Split = "eighty_twenty"
    width: Annotated[int, Field(ge=1, le=WIDEST)] | None = None
    channels: Literal["auto", 1, 3] = "auto"
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


def split_names(names: list[str], how: str, shipped: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Return the names of the training views and of the test views, each sorted. Raises ValueError if either is empty.

    how: `eighty_twenty`: the 1st, 6th, 11th ... sorted name is a test view (the paper's 80 % / 20 %); `every_8th`: the
    1st, 9th, 17th ... (3DGS, ThermalGaussian); `folder`: as shipped. shipped: `train` or `test` by name.

    >>> split_names(["a", "b", "c", "d", "e", "f"], "eighty_twenty", {})
    (['b', 'c', 'd', 'e'], ['a', 'f'])
    """
    if how not in SPLITS:
        raise ValueError(f"split is {how!r}; it must be one of {', '.join(SPLITS)}")
    names = sorted(names)
    if how == "folder":
        unplaced = [name for name in names if name not in shipped]
        if unplaced:
            raise ValueError(
                "split=folder needs train/ and test/ folders, which this scene does not have "
                f"(view {unplaced[0]}); use eighty_twenty or every_8th"
            )
        test = [name for name in names if shipped[name] == "test"]
    else:
        test = names[:: 5 if how == "eighty_twenty" else 8]
    chosen = set(test)
    train = [name for name in names if name not in chosen]
    if not train or not test:
        raise ValueError(
            f"split={how} gives {len(train)} training and {len(test)} test views of the {len(names)} with a "
            "thermal image and a pose; both are needed"
        )
    return train, test
