"""Layouts of scene folders: one module each says whether a folder has it, and finds what is there."""

from pathlib import Path

from tdgbench.scenes.layouts import rgbt_scenes, thermalmix, thermoscenes, ti_nsd
from tdgbench.scenes.layouts.layout import Found, Layout

# In the order in which they are looked for: each is more general than those before it.
LAYOUTS = {one.name: one for one in (m.LAYOUT for m in (thermalmix, thermoscenes, rgbt_scenes, ti_nsd))}

__all__ = ["LAYOUTS", "Found", "Layout", "detect"]


def detect(folder: Path) -> Layout | None:
    """The layout of a folder; None if it has none. Raises SceneError if that cannot be told."""
    return next((layout for layout in LAYOUTS.values() if layout.fits(folder)), None)
