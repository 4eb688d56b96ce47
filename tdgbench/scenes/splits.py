"""Split views into training and test views. Every record names its split."""

from __future__ import annotations

from collections.abc import Mapping

SPLITS = ("eighty_twenty", "every_8th", "folder")


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
            f"split={how} gives {len(train)} training and {len(test)} test views of {len(names)}; both are needed"
        )
    return train, test
