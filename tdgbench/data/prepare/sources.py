"""Find the camera's files of each view: a radiometric file with its own photo, a thermal and an RGB file, or one."""

from __future__ import annotations

import glob
from dataclasses import dataclass, field
from pathlib import Path

from tdgbench.scenes import SceneError
from tdgbench.scenes.images import SUFFIXES
from tdgbench.scenes.inputs import check_view_name, is_folder, listed
from tdgbench.scenes.layouts.layout import find_files
from tdgbench.scenes.radiometric import is_radiometric

EXAMPLE = "--pairs '*_T.tiff' '*_V.jpg'"


@dataclass(frozen=True)
class ViewFiles:
    """Files of one view. rgb: None if the photo is inside the thermal file, or not looked for."""

    view: str
    thermal: Path
    rgb: Path | None


@dataclass(frozen=True)
class Sources:
    """What a folder holds: views, and files that belong to none of them, with the reason."""

    views: list[ViewFiles]
    left_out: dict[Path, str] = field(default_factory=dict)


def find_sources(folder: Path, pairs: tuple[str, str] | None = None, thermal_alone: bool = False) -> Sources:
    """Find the views in a folder of camera files.

    pairs: patterns of the thermal and of the RGB files below the folder, in which `*` stands for the view's name. By
    default, files in thermal/ and rgb/ are paired by name, where these folders are; else radiometric files (in the
    folder or in raw_images/) with the RGB files of the same name, or with the photos inside them.
    thermal_alone: RGB images are not looked for; all images in the folder, or in its thermal/, are thermal.
    Raises SceneError if there is no view.
    """
    if not is_folder(folder):
        raise SceneError(f"{folder} is no folder; give the folder of the camera's files")
    if thermal_alone:
        return _thermal_alone(folder, pairs)
    if pairs is not None:
        sources = _pair(*(_matching(folder, pattern) for pattern in pairs))
    elif is_folder(folder / "thermal") and is_folder(folder / "rgb"):
        sources = _pair(find_files(folder / "thermal")[0], find_files(folder / "rgb")[0])
    else:
        sources = _by_content(folder / "raw_images" if is_folder(folder / "raw_images") else folder)
    if not sources.views:
        reasons = "; ".join(f"{path.name}: {reason}" for path, reason in list(sources.left_out.items())[:2])
        remedy = f"it must hold radiometric JPEG of FLIR, or files of equal names, or be told names as by {EXAMPLE}"
        if pairs is not None:
            remedy = f"{pairs[0]!r} and {pairs[1]!r} must match files of equal view names"
        what = "no pair of thermal and RGB images" + (f" ({reasons})" if reasons else "")
        raise SceneError(f"{folder} holds {what}; {remedy}")
    return sources


def _thermal_alone(folder: Path, pairs: tuple[str, str] | None) -> Sources:
    if pairs is not None:
        files = _matching(folder, pairs[0])
    else:
        files = find_files(folder / "thermal" if is_folder(folder / "thermal") else folder)[0]
    if not files:
        raise SceneError(f"{folder} holds no thermal image; say which files they are, as by {EXAMPLE}")
    return Sources([ViewFiles(view, path, None) for view, path in files.items()])


def _matching(folder: Path, pattern: str) -> dict[str, Path]:
    """Return files by view name: what the pattern's `*` stands for."""
    before, star, after = pattern.partition("*")
    if not star or "*" in after or Path(pattern).is_absolute() or ".." in Path(pattern).parts:
        raise SceneError(f"--pairs: {pattern!r} must be a path below {folder} with one * for the view's name")
    views = {}
    for path in sorted(folder.glob(f"{glob.escape(before)}*{glob.escape(after)}")):
        name = path.relative_to(folder).as_posix()
        if path.name.startswith("."):
            continue  # macOS writes ._NAME beside a file
        view = check_view_name(name[len(before) : len(name) - len(after)], f"{folder}: the file {name!r}")
        views[view] = path
    return views


def _pair(thermal: dict[str, Path], rgb: dict[str, Path]) -> Sources:
    """Pair files by view name; a FLIR file without an RGB file brings its own photo."""
    views, left_out = [], {}
    for view, path in thermal.items():
        if view in rgb or _may_hold_photo(path):
            views.append(ViewFiles(view, path, rgb.get(view)))
        else:
            left_out[path] = f"no RGB image is named {view}"
    left_out.update({path: f"no thermal image is named {view}" for view, path in rgb.items() if view not in thermal})
    return Sources(views, left_out)


def _by_content(folder: Path) -> Sources:
    thermal: dict[str, Path] = {}
    rgb: dict[str, Path] = {}
    left_out = {}
    for path in listed(folder):
        if path.suffix.lower() not in SUFFIXES or path.name.startswith("."):
            continue
        check_view_name(path.stem, f"{folder}: the file {path.name!r}")
        try:
            kind = thermal if is_radiometric(path) else rgb
        except SceneError as error:
            left_out[path] = str(error)
            continue
        if path.stem in kind:
            left_out[path] = f"{kind[path.stem].name} is the same view; remove one of them"
        else:
            kind[path.stem] = path
    pairs = _pair(thermal, rgb)
    return Sources(pairs.views, {**left_out, **pairs.left_out})


def _may_hold_photo(path: Path) -> bool:
    try:
        return path.suffix.lower() in (".jpg", ".jpeg") and is_radiometric(path)
    except SceneError:
        return False
