"""What every layout says about a folder, and the steps that layouts share."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import SUFFIXES
from tdgbench.scenes.inputs import check_view_name, is_folder, is_there, listed, regular_file
from tdgbench.scenes.scene import PointCloud, TemperatureRange
from tdgbench.scenes.temperature import FILE, Radiometry, read_radiometry


@dataclass(frozen=True)
class SceneFiles:
    """What a layout found in the folder of a scene; paths, poses and splits are by view name."""

    posed: dict[str, RegisteredImage]
    points: PointCloud | None
    thermal: dict[str, Path] = field(default_factory=dict)
    rgb: dict[str, Path] = field(default_factory=dict)
    shipped: dict[str, str] = field(default_factory=dict)  # `train` or `test`
    radiometry: Radiometry | None = None  # of 8- and 16-bit images
    in_celsius: bool = False  # thermal files are arrays (H, W) or (H, W, 1) of °C, or gray images of a known range
    files: list[Path] = field(default_factory=list)  # besides images: what the scene is read from
    notes: list[str] = field(default_factory=list)  # what is doubtful about it
    unwarped: dict[str, Path] = field(default_factory=dict)  # gray thermal images before they were warped


@dataclass(frozen=True)
class Layout:
    """How the folder of a scene is organised."""

    name: str  # option `dataset`
    title: str  # as results and messages name it
    looks: str  # inside the folder of a scene, in one line
    fits: Callable[[Path], bool]  # whether a folder has this layout; raises SceneError if that cannot be told
    find: Callable[[Path], SceneFiles]  # raises SceneError naming the file and the remedy
    published: Callable[[str], TemperatureRange | None] = lambda name: None  # °C of gray images, by a scene's name


def find_model(folder: Path, places: Iterable[str], title: str) -> SceneFiles:
    """Read the COLMAP model in the first of `places` that is there, and temperature.json. Raises SceneError.

    Returns what is known by these; images are to be added.
    """
    place = model_folder(folder, places)
    if place is None:
        first = next(iter(places))
        raise SceneError(
            f"{folder} has no COLMAP model in {first}; run COLMAP on its RGB images first (read as {title})"
        )
    posed, points = read_model(place)
    files = [*(path for path in listed(place) if path.is_file()), *([folder / FILE] if is_there(folder / FILE) else [])]
    return SceneFiles(posed, points, radiometry=read_radiometry(folder / FILE), files=files)


def model_folder(folder: Path, places: Iterable[str]) -> Path | None:
    """Return the first of `places` that is a folder, or None."""
    return next((folder / place for place in places if is_folder(folder / place)), None)


def find_files(
    folder: Path, suffixes: tuple[str, ...] = SUFFIXES, but: Container[str] = ()
) -> tuple[dict[str, Path], dict[str, str]]:
    """Find files by view name; and by view name `train` or `test`, where these subfolders exist.

    suffixes: in lower case; those of files may be in upper case. but: views that are passed over. Raises SceneError for
    a name that no result could have, for two files of one view, and for what is no regular file.
    """
    paths: dict[str, Path] = {}
    shipped: dict[str, str] = {}
    subfolders = [name for name in ("train", "test") if is_folder(folder / name)]
    for sub in subfolders or [""]:
        for path in listed(folder / sub):
            if path.suffix.lower() not in suffixes or path.name.startswith(".") or path.stem in but:
                continue
            check_view_name(path.stem, f"{path.parent}: the file {path.name!r}")
            regular_file(path)
            if path.stem in paths:
                raise SceneError(f"{path} and {paths[path.stem]} are both view {path.stem}; keep one of them")
            paths[path.stem] = path
            if sub:
                shipped[path.stem] = sub
    return paths, shipped


def find_optional(folder: Path, what: str) -> dict[str, Path]:
    """Find images by view name; none without the folder. what: of which kind, for messages."""
    if not is_there(folder):
        return {}
    if not is_folder(folder):
        raise SceneError(f"{folder} is no folder; replace it by a folder of {what}, or remove it")
    return find_files(folder)[0]
