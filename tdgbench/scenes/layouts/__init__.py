"""Layouts of scene folders: each says whether a folder has it, and finds what is there."""

from pathlib import Path

from tdgbench.scenes.layouts import thermalmix, thermoscenes
from tdgbench.scenes.layouts.layout import Layout, SceneFiles
from tdgbench.scenes.layouts.plain import RGBT_SCENES, TI_NSD

# In the order in which they are looked for: each is more general than those before it.
_ORDER = thermalmix.LAYOUT, thermoscenes.LAYOUT, thermoscenes.SEAR, RGBT_SCENES, TI_NSD
LAYOUTS = {layout.name: layout for layout in _ORDER}

__all__ = ["LAYOUTS", "Layout", "SceneFiles", "detect"]


def detect(folder: Path) -> Layout | None:
    """Return the layout of a folder; None if it has none. Raises SceneError if that cannot be told."""
    return next((layout for layout in LAYOUTS.values() if layout.fits(folder)), None)
