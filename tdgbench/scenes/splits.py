"""Which views are trained on and which are tested. The record of every result says which split it used."""

from __future__ import annotations

from collections.abc import Mapping

SPLITS = ("eighty_twenty", "every_8th", "folder")


def split_names(names: list[str], how: str, shipped: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Training and test names, each sorted.

    `eighty_twenty`: every 5th of the sorted names, from the first, is tested (the paper's 80 % / 20 %);
    `every_8th`: every 8th (3DGS, ThermalGaussian); `folder`: as shipped (name → train | test).
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
        raise ValueError(f"split={how} leaves {len(train)} training and {len(test)} test views of {len(names)}")
    return train, test
