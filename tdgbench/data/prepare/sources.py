"""Find the camera's files of each view: a radiometric file with its own photo, a thermal and an RGB file, or one."""

from __future__ import annotations

import glob
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from tdgbench.data.prepare.dji import CELSIUS, RAW, computed_of, paired_by_number, product, shot_and_lens
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import SUFFIXES, header
from tdgbench.scenes.formats.pictures import JPEG
from tdgbench.scenes.inputs import check_view_name, is_folder, listed
from tdgbench.scenes.names import about_unread
from tdgbench.text import first_few

EXAMPLE = "--pairs '*_T.tiff' '*_V.jpg'"
OF_VIEWS = ("", CELSIUS)  # products that a view is read from
THERMAL, WIDE = ("T",), ("V", "W")  # DJI's lenses; Z, zoom, and S, the screen, do not show what they do


class ViewFiles(NamedTuple):
    """Files of one view. rgb: None if the photo is inside the thermal file, or not looked for.

    origin: the camera's file that another program computed the thermal one of; it states position and camera.
    """

    view: str
    thermal: Path
    rgb: Path | None
    origin: Path | None = None


@dataclass(frozen=True)
class Sources:
    """What a folder holds: views, files that belong to none of them, with the reason, and what is assumed."""

    views: list[ViewFiles] = field(default_factory=list)
    left_out: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


class _Images(NamedTuple):
    """Thermal and RGB files by view name."""

    thermal: dict[str, Path]
    rgb: dict[str, Path]

    def add(self, path: Path, view: str, is_thermal: bool, left_out: dict[Path, str]) -> None:
        """Add a file, unless its view has one; of a camera's file and what was computed of it, the latter counts."""
        known = self.thermal if is_thermal else self.rgb
        other = known.setdefault(view, path)
        if computed_of(path) == other:
            known[view] = path
        elif path != other and computed_of(other) != path:
            left_out[path] = f"{other.name} is the same view; remove one of them"


def find_sources(folder: Path, pairs: tuple[str, str] | None = None, thermal_alone: bool = False) -> Sources:
    """Find the views in a folder of camera files.

    pairs: patterns of the thermal and of the RGB files below the folder, in which `*` stands for the view's name. By
    default, files in thermal/ and rgb/ are paired by name, where these folders are; else radiometric files (in the
    folder or in raw_images/) with the RGB files of the same name, or with the photos inside them. DJI's files of one
    shot have one name but for the lens, and times that are up to 2 s apart.
    thermal_alone: RGB images are not looked for; all images in the folder, or in its thermal/, are thermal.
    Raises SceneError if there is no view.
    """
    if not is_folder(folder):
        raise SceneError(f"{folder} is no folder; give the folder of the camera's files")
    sources, images = Sources(), _Images({}, {})
    has_thermal, has_rgb, has_raw = (is_folder(folder / name) for name in ("thermal", "rgb", "raw_images"))
    if pairs is not None:
        images = _Images(_matching(folder, pairs[0]), {} if thermal_alone else _matching(folder, pairs[1]))
    elif thermal_alone:
        _sort(folder / "thermal" if has_thermal else folder, "thermal", images, sources)
    elif has_thermal and has_rgb:
        for modality in ("thermal", "rgb"):
            _sort(folder / modality, modality, images, sources)
    else:
        _sort(folder / "raw_images" if has_raw else folder, "", images, sources)
    _pair(images, thermal_alone, sources)
    if not sources.views:
        raise _nothing(folder, pairs, thermal_alone, sources)
    return sources


def _nothing(folder: Path, pairs: tuple[str, str] | None, thermal_alone: bool, sources: Sources) -> SceneError:
    reasons = "; ".join([*sources.notes, *(f"{p.name}: {why}" for p, why in list(sources.left_out.items())[:2])])
    what = "thermal image" if thermal_alone else "pair of thermal and RGB images"
    if thermal_alone:
        remedy = f"say which files they are, as by {EXAMPLE}"
    elif pairs is not None:
        remedy = f"{pairs[0]!r} and {pairs[1]!r} must match files of equal view names"
    else:
        remedy = (
            f"it must hold radiometric JPEG of FLIR, or files of equal names, or be told names as by {EXAMPLE}; "
            "thermal images alone need --sfm thermal"
        )
    return SceneError(f"{folder} holds no {what}" + (f" ({reasons})" if reasons else "") + f"; {remedy}")


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
        view = unicodedata.normalize("NFC", name[len(before) : len(name) - len(after)])
        views[check_view_name(view, f"{folder}: the file {name!r}")] = path
    return views


def _pair(images: _Images, thermal_alone: bool, sources: Sources) -> None:
    """Add the views: files paired by name; a FLIR file without an RGB file brings its own photo."""
    thermal, rgb = images
    by_number, unclear = paired_by_number(thermal.keys() - rgb.keys(), rgb.keys() - thermal.keys())
    for view, path in thermal.items():
        photo = rgb.get(by_number.get(view, view))
        holds_photo = False
        with suppress(SceneError):
            holds_photo = path.suffix.lower() in JPEG and _is_radiometric(path)
        if photo is not None or thermal_alone or holds_photo:
            sources.views.append(ViewFiles(view, path, photo, computed_of(path)))
        else:
            sources.left_out[path] = unclear.get(view, f"no RGB image is named {view}")
    paired = thermal.keys() | set(by_number.values())
    for view, path in rgb.items():  # in the files' order: a stage's key holds what is left out
        if view not in paired:
            sources.left_out[path] = f"no thermal image is named {view}"
    if by_number:
        sources.notes.append(f"{len(by_number)} pairs differ by up to 2 s in their names: paired by the running number")
    if count := sum(one.origin is not None for one in sources.views):
        what = "another program computed them of the camera's JPEG beside, whose position and EXIF data hold"
        sources.notes.append(f"temperatures of {count} views: {what}")


def _sort(folder: Path, modality: str, images: _Images, sources: Sources) -> None:
    """Add the images of a folder, of a modality or each by its content; other lenses and products are passed over."""
    names = [path.name for path in listed(folder) if not path.name.startswith(".")]
    read = [name for name in names if Path(name).suffix.lower() in (*SUFFIXES, RAW)]
    bases = {base for base, kind in map(product, map(_name, read)) if kind in OF_VIEWS}
    passed = []
    for path in map(folder.joinpath, read):
        view, _ = shot_and_lens(_name(path.name))
        check_view_name(view, f"{folder}: the file {path.name!r}")
        try:
            is_thermal = modality == "thermal" if modality else _is_radiometric(path)
        except SceneError as error:
            sources.left_out[path] = str(error)
            continue
        if _is_of_view(path, is_thermal, bases):
            images.add(path, view, is_thermal, sources.left_out)
        else:
            passed.append(path.name)
    if passed:
        what = "are of another lens, or other products of a view's file, and are not read"
        sources.notes.append(f"{len(passed)} files {what} ({first_few(passed)})")
    unread = sorted(set(names) - set(read))
    sources.notes.extend(about_unread(f"{folder.name}/", unread, {*map(_name, read)}))


def _is_of_view(path: Path, is_thermal: bool, bases: set[str]) -> bool:
    """Return whether a file is of a lens that is read, and no further product. bases: names of files that are read."""
    (base, kind), (_, lens) = product(_name(path.name)), shot_and_lens(_name(path.name))
    return lens in ("", *(THERMAL if is_thermal else WIDE)) and (kind in OF_VIEWS or base not in bases)


def _name(file: str) -> str:
    return unicodedata.normalize("NFC", Path(file).stem)


def _is_radiometric(path: Path) -> bool:
    """Return whether a file is thermal by its content: counts or °C. 16-bit PNG may be anything. Raises SceneError."""
    if path.suffix.lower() == RAW:
        return True
    found = header(path)
    return found.meaning != "shown" and not found.may_be_shown
