"""Names of views: one rule for files, COLMAP models, transforms.json and the files of other programs.

A name is a path, relative to some folder: COLMAP's is one below its --image_path (COLMAP 02e8ba8, doc/faq.rst). macOS
decomposes accents in file names, so names are compared in Unicode's composed form, NFC.
"""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import takewhile
from pathlib import PurePosixPath

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import SUFFIXES
from tdgbench.scenes.formats.unread import UNREAD
from tdgbench.scenes.inputs import check_view_name
from tdgbench.text import first_few

USUAL = {"images", "input", "rgb", "thermal"}  # folders of images, which tell no views apart
_EXTENSIONS = {*SUFFIXES, *UNREAD, ".npy"}
_Ranked = tuple[tuple[int, int], str]  # rank of a file among a view's, and the file


def key(name: str) -> str:
    r"""Return a path of an image as it is compared: with /, composed, without the extension of an image.

    >>> key(r"left\0001.PNG"), key("./2024.05.01_v.0.png"), key("flight.view000"), key("Geba\u0308ude.jpg")
    ('left/0001', '2024.05.01_v.0', 'flight.view000', 'Gebäude')
    """
    path = PurePosixPath(unicodedata.normalize("NFC", name.replace("\\", "/")))
    return str(path.with_suffix("") if path.suffix.lower() in _EXTENSIONS else path)


def view_names(keys: Iterable[str], where: str) -> dict[str, str]:
    """Return a view's name by key: the base name if these are unique, else the path below the common folders.

    where: the file that has the names, for messages. Raises SceneError for views of one name, or names that no result
    can have.

    >>> view_names(["left/a", "right/b"], "it"), view_names(["images/left/1", "images/right/1"], "it")
    ({'left/a': 'a', 'right/b': 'b'}, {'images/left/1': 'left_1', 'images/right/1': 'right_1'})
    """
    keys = list(keys)
    parts = [one.split("/") for one in keys]
    names = [path[-1] for path in parts]
    if _twice(names):
        common = _common(parts)
        names = ["_".join(path[common:]) for path in parts]
    if clash := _twice(keys) or _twice(names):
        raise SceneError(f"{where} has two images named {clash[0]}; view names must be unique in a scene")
    return {one: check_view_name(name, f"{where}: image {one!r}") for one, name in zip(keys, names, strict=True)}


def of_modality(keys: Iterable[str], folder: str, other: str) -> list[str]:
    """Return the images of one modality, where a folder in their paths tells them apart; else all.

    >>> of_modality(["rgb/a", "thermal/a"], "thermal", "rgb"), of_modality(["rgb/a"], "thermal", "rgb")
    (['thermal/a'], ['rgb/a'])
    """
    parts = {one: one.casefold().split("/")[:-1] for one in keys}
    inside = [one for one, path in parts.items() if folder in path]
    return inside or [one for one, path in parts.items() if other not in path] or list(parts)


def pair(files: Iterable[str], views: Mapping[str, str], where: str) -> dict[str, str]:
    """Return the file of each view that has one. files: keys; views: keys by view name. where: of the files.

    A file's path must be the end of the view's. Where all files lie in subfolders, the view's may be that of the
    file's, and base names pair if they are unique on both sides. The longest common end wins, then the path with least
    before it. Raises SceneError for a file of two views, or two files of one.

    >>> pair(["left/1", "right/1"], {"left_1": "cam/left/1", "right_1": "cam/right/1"}, "it")
    {'left_1': 'left/1', 'right_1': 'right/1'}
    >>> pair(["1", "right/1"], {"1": "1", "right_1": "right/1"}, "it")
    {'1': '1', 'right_1': 'right/1'}
    """
    files = list(files)
    by_base: dict[str, list[str]] = {}
    for view, path in views.items():
        by_base.setdefault(_base(path), []).append(view)
    nested = all("/" in one for one in files)
    loose = not _twice(map(_base, files)) and not _twice(map(_base, views.values()))
    found: dict[str, list[_Ranked]] = {}
    for file in files:
        ranks = {file: (1, 0)} if file in views else {}
        for view in by_base.get(_base(file), []):
            if (rank := _rank(file, views[view], nested, loose)) is not None:
                ranks[view] = rank
        best = [view for view, rank in ranks.items() if rank == max(ranks.values())]
        if len(best) > 1:
            named = " or ".join(views[view] for view in sorted(best)[:2])
            raise SceneError(f"{where}: {file} may be {named}; put images into folders as the poses name them")
        for view in best:
            found.setdefault(view, []).append((ranks[view], file))
    return {view: _best(view, candidates, where) for view, candidates in found.items()}


def _best(view: str, candidates: list[_Ranked], where: str) -> str:
    """Return the file that fits a view best. Raises SceneError for two such files."""
    candidates = sorted(candidates, reverse=True)
    if len(candidates) > 1 and candidates[0][0] == candidates[1][0]:
        both = " and ".join(sorted(file for _, file in candidates[:2]))
        raise SceneError(f"{where}: {both} are both view {view}; keep one of them")
    return candidates[0][1]


def _rank(file: str, path: str, nested: bool, loose: bool) -> tuple[int, int] | None:
    """Return how well a file fits the path of a view with its base name, best last; None if it does not."""
    parts, known = file.split("/"), path.split("/")
    common = _common([parts[::-1], known[::-1]])
    fits = common == len(parts) or (nested and (loose or common == len(known)))
    return (common, -abs(len(known) - len(parts))) if fits else None


def in_other_folders(files: Mapping[str, str], views: Mapping[str, str]) -> str:
    """Return which folders paired files and views lie in, if these differ, but for folders that are USUAL; else "".

    files, views: keys by view name.

    >>> in_other_folders({"1": "monday/1"}, {"1": "rgb/tuesday/1"}), in_other_folders({"1": "left/1"}, {"1": "rgb/1"})
    ('files in monday/, poses of tuesday/', '')
    """
    own_folders, folders = set[str](), set[str]()
    for view, file in files.items():
        own, posed = ([p for p in one.split("/")[:-1] if p.casefold() not in USUAL] for one in (file, views[view]))
        if own and posed and own[-len(posed) :] != posed[-len(own) :]:
            own_folders.add("/".join([*own, ""]))
            folders.add("/".join([*posed, ""]))
    return f"files in {first_few(own_folders)}, poses of {first_few(folders)}" if folders else ""


def in_case_alone(files: Iterable[str], views: Iterable[str]) -> list[str]:
    """Return a file and a view without a partner whose names differ in case alone, or nothing.

    >>> in_case_alone(["VIEW1"], ["view1"]), in_case_alone(["a"], ["b"])
    (['VIEW1', 'view1'], [])
    """
    folded = {one.casefold(): one for one in sorted(views)}
    return next(([one, folded[one.casefold()]] for one in sorted(files) if one.casefold() in folded), [])


def about_unread(where: str, names: Iterable[str], read: Iterable[str]) -> list[str]:
    """Return, for notes, which of a folder's files hold pixels and are not read, where no other file is that view.

    >>> about_unread("rgb", ["a.heic", "b.dng", "notes.txt"], {"b"})
    ['rgb holds 1 files that are not read (a.heic); convert them to PNG']
    """
    read = set(read)
    lost: dict[str, list[str]] = {}
    for name in names:
        kind = UNREAD.get(PurePosixPath(name).suffix.lower())
        if kind is not None and key(name) not in read:
            lost.setdefault(kind, []).append(name)
    return [
        f"{where} holds {len(names)} files that are not read ({first_few(names)}); convert them to {kind}"
        for kind, names in lost.items()
    ]


def _base(path: str) -> str:
    return path.rpartition("/")[2]


def _twice(values: Iterable[str]) -> list[str]:
    return [value for value, count in Counter(values).items() if count > 1]


def _common(paths: list[list[str]]) -> int:
    """Return how many first parts all paths share."""
    return sum(1 for _ in takewhile(lambda column: len({*column}) == 1, zip(*paths, strict=False)))
