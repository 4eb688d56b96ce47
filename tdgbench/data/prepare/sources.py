"""Find the camera's files of each view: a radiometric file with its own photo, a thermal and an RGB file, or one."""

from __future__ import annotations

import glob
import unicodedata
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from tdgbench.data.prepare.dji import CELSIUS, JPEG, RAW, computed_of, product, shot_and_lens, stamped_apart
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import SUFFIXES, header
from tdgbench.scenes.inputs import check_view_name, is_folder, listed
from tdgbench.scenes.names import about_unread
from tdgbench.text import first_few

EXAMPLE = "--pairs '*_T.tiff' '*_V.jpg'"
THERMAL, WIDE = ("T",), ("V", "W")  # DJI's lenses; Z, zoom, does not show what they do


@dataclass(frozen=True)
class ViewFiles:
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

    views: list[ViewFiles]
    left_out: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


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
    has_thermal, has_rgb, has_raw = (is_folder(folder / name) for name in ("thermal", "rgb", "raw_images"))
    if pairs is not None:
        found = _Files(_matching(folder, pairs[0]), {} if thermal_alone else _matching(folder, pairs[1]))
    elif thermal_alone:
        found = _sorted(folder / "thermal" if has_thermal else folder, "thermal")
    elif has_thermal and has_rgb:
        found, photos = _sorted(folder / "thermal", "thermal"), _sorted(folder / "rgb", "rgb")
        found = _Files(found.thermal, photos.rgb, found.left_out | photos.left_out, found.notes + photos.notes)
    else:
        found = _sorted(folder / "raw_images" if has_raw else folder)
    sources = _pair(found, thermal_alone)
    if not sources.views:
        raise _nothing(folder, pairs, thermal_alone, sources)
    return sources


@dataclass(frozen=True)
class _Files:
    """Files by view name, and what Sources has beside."""

    thermal: dict[str, Path] = field(default_factory=dict)
    rgb: dict[str, Path] = field(default_factory=dict)
    left_out: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def _nothing(folder: Path, pairs: tuple[str, str] | None, thermal_alone: bool, sources: Sources) -> SceneError:
    reasons = "; ".join([*sources.notes, *(f"{p.name}: {why}" for p, why in list(sources.left_out.items())[:2])])
    what, remedy = "thermal image", f"say which files they are, as by {EXAMPLE}"
    if not thermal_alone:
        what = "pair of thermal and RGB images"
        remedy = f"it must hold radiometric JPEG of FLIR, or files of equal names, or be told names as by {EXAMPLE}"
        if pairs is not None:
            remedy = f"{pairs[0]!r} and {pairs[1]!r} must match files of equal view names"
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


def _pair(files: _Files, thermal_alone: bool) -> Sources:
    """Pair files by view name; a FLIR file without an RGB file brings its own photo."""
    thermal, rgb = files.thermal, files.rgb
    apart, unclear = stamped_apart(thermal.keys() - rgb.keys(), rgb.keys() - thermal.keys())
    found = Sources([], dict(files.left_out), list(files.notes))
    for view, path in thermal.items():
        photo = rgb.get(apart.get(view, view))
        if photo is not None or thermal_alone or _may_hold_photo(path):
            found.views.append(ViewFiles(view, path, photo, computed_of(path)))
        else:
            found.left_out[path] = unclear.get(view, f"no RGB image is named {view}")
    lonely = rgb.keys() - thermal.keys() - set(apart.values())
    found.left_out.update({path: f"no thermal image is named {view}" for view, path in rgb.items() if view in lonely})
    if apart:
        found.notes.append(f"{len(apart)} pairs differ by up to 2 s in their names: paired by the running number")
    if count := sum(one.origin is not None for one in found.views):
        what = "another program computed them of the camera's JPEG beside, whose position and EXIF data hold"
        found.notes.append(f"temperatures of {count} views: {what}")
    return found


def _sorted(folder: Path, modality: str = "") -> _Files:
    """Return the files of a folder, of a modality or each by its content; other lenses and products are passed over."""
    files, passed = _Files(), []
    names = [path.name for path in listed(folder) if not path.name.startswith(".")]
    read = [name for name in names if Path(name).suffix.lower() in (*SUFFIXES, RAW)]
    bases = {base for base, kind in map(product, map(_name, read)) if kind in ("", CELSIUS)}
    for path in (folder / name for name in read):
        (base, kind), (view, lens) = product(_name(path.name)), shot_and_lens(_name(path.name))
        check_view_name(view, f"{folder}: the file {path.name!r}")
        try:
            is_thermal = modality == "thermal" if modality else is_radiometric(path)
        except SceneError as error:
            files.left_out[path] = str(error)
            continue
        if lens not in ("", *(THERMAL if is_thermal else WIDE)) or (kind not in ("", CELSIUS) and base in bases):
            passed.append(path.name)
            continue
        found = files.thermal if is_thermal else files.rgb
        other = found.setdefault(view, path)
        if computed_of(path) == other:
            found[view] = path
        elif path != other and computed_of(other) != path:
            files.left_out[path] = f"{other.name} is the same view; remove one of them"
    what = "are of another lens, or other products of a view's file, and are not read"
    files.notes.extend([f"{len(passed)} files {what} ({first_few(passed)})"] if passed else [])
    files.notes.extend(about_unread(f"{folder.name}/", (one for one in names if one not in read), {*map(_name, read)}))
    return files


def _name(file: str) -> str:
    return unicodedata.normalize("NFC", Path(file).stem)


def is_radiometric(path: Path) -> bool:
    """Return whether a file is thermal by its content: counts or °C. 16-bit PNG may be anything. Raises SceneError."""
    if path.suffix.lower() == RAW:
        return True
    found = header(path)
    return found.meaning != "shown" and found.format != "PNG"


def _may_hold_photo(path: Path) -> bool:
    with suppress(SceneError):
        return path.suffix.lower() in JPEG and is_radiometric(path)
    return False
