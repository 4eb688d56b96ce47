"""Fetch a data set: list, compare with what is there, download, unpack."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from tdgbench.bench.lock import file_lock
from tdgbench.data.get import drive, resume, zenodo
from tdgbench.data.get.errors import BadFileError, GetError, is_full
from tdgbench.data.get.http import PATIENT, Patience
from tdgbench.data.get.packages import Found, Listing, Package, State, chosen, found_scenes, sort_out, state
from tdgbench.data.get.place import Place, check_space, place_archive, place_files
from tdgbench.data.get.progress import amount, meter
from tdgbench.data.get.remote import RemoteFile
from tdgbench.data.get.sources import Source
from tdgbench.terminal import say
from tdgbench.text import one_line

DOWNLOADS = ".get"  # folder of downloads in the folder of the data set; hidden, so that it is no scene
LEFT = "{} is left as it is: it was not fetched by this command (--force replaces it)"
_LEFTOVERS = "tmp????????"  # temporary files of pooch that a killed process leaves


@dataclass(frozen=True)
class Options:
    """What is fetched, and how.

    scenes: names; empty: all. force: fetch and replace what is there. keep: keep archives. zenodo: address of Zenodo.
    """

    scenes: tuple[str, ...] = ()
    force: bool = False
    keep: bool = False
    zenodo: str = zenodo.ADDRESS
    patience: Patience = PATIENT


@dataclass(frozen=True)
class Job:
    """The download of one data set into `folder`."""

    source: Source
    folder: Path
    options: Options

    @property
    def downloads(self) -> Path:
        return self.folder / DOWNLOADS

    def target(self, path: PurePosixPath) -> Path:
        """Where a published file is downloaded to."""
        return self.downloads.joinpath(path)


def listing(source: Source, options: Options) -> Listing:
    """What is published, without scenes that were not asked for. Raises GetError."""
    if source.host == "Zenodo":
        files = zenodo.list_record(source, options.zenodo, options.patience)
    else:
        files = drive.list_folder(source, options.patience)
    found = sort_out(source, files)
    return Listing(tuple(chosen(source, found.packages, options.scenes)), found.unreadable, found.others)


def states(job: Job, packages: Iterable[Package], there: Mapping[str, Found]) -> dict[Package, State]:
    """Which packages are among the scenes that are there; none with `force`."""
    return {package: State.MISSING if job.options.force else state(package, there) for package in packages}


def fetch(job: Job) -> bool:
    """Fetch a data set and say what was done; whether all of it is there, whole, at the end.

    Raises GetError and OSError for what stops the whole download; a file that cannot be used does not. What was
    downloaded is kept then, and the same call goes on from it. An interruption has a note that says so.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    with file_lock(job.downloads / ".lock") as acquired:
        if not acquired:
            raise GetError(f"another process is fetching into {job.folder}; wait for its end")
        for leftover in job.downloads.glob(_LEFTOVERS):
            leftover.unlink()
        try:
            return _fetch(job, listing(job.source, job.options))
        except OSError as error:
            if not is_full(error):
                raise
            raise GetError(f"the disk of {job.folder} is full: {kept(job)}; free some space first") from error
        except KeyboardInterrupt as interruption:
            interruption.add_note(kept(job))
            raise


def kept(job: Job) -> str:
    """What an unfinished download leaves on disk."""
    size = sum(path.stat().st_size for path in job.downloads.rglob("*") if path.is_file())
    return f"{job.downloads} keeps {amount(size)} of downloads; the same command goes on from there"


def _fetch(job: Job, found: Listing) -> bool:
    there = found_scenes(job.source, job.folder)
    before = states(job, found.packages, there)
    missing = [package for package, one in before.items() if one is State.MISSING]
    _check_space(job, missing)
    problems = [
        *_problems_of_listing(job, found),
        *(problem for package, one in before.items() if (problem := _problem_of_scene(package, one, there))),
    ]
    for problem in problems:
        _say_problem(problem)
    fetched, refused = 0, 0
    for package in missing:
        try:
            fetched += _fetch_package(job, package)
        except BadFileError as error:
            _say_problem(str(error))
            refused += 1
    whole = sum(one.is_of(package) for package in before for one in there.values() if before[package] is State.THERE)
    bad = len(problems) + refused
    end = _count(bad, "problem") if bad else f"{_count(whole, 'scene')} already there and whole"
    _say(f"{job.folder}: {_count(fetched, 'scene')} fetched, {end}")
    return not bad


def _problems_of_listing(job: Job, found: Listing) -> list[str]:
    """Published archives that cannot be unpacked; what is no part of a scene is named, but no problem."""
    if found.others:
        _say(f"not fetched, being no part of a scene: {', '.join(map(str, found.others))} ({job.source.page})")
    return [
        f"{path} cannot be unpacked by this program: open {job.source.page} in a browser and unpack it to "
        f"{job.folder}/<Scene>"
        for path in found.unreadable
    ]


def _problem_of_scene(package: Package, one: State, there: Mapping[str, Found]) -> str | None:
    """What is wrong with a package that is there; None if nothing is. A scene of other origin is no problem."""
    if one is State.THERE:
        made = [found for found in there.values() if found.is_of(package)]
        return next((damage for found in made if (damage := _damage(found))), None)
    if package.scene is None or one is State.MISSING:
        return None
    folder = there[package.scene].folder
    if one is State.FOREIGN:
        _say(LEFT.format(folder))
        return None
    return (
        f"{folder} is another version than {package.name}, which is published now; --force --scene {package.scene} "
        "fetches that"
    )


def _damage(found: Found) -> str | None:
    """What of a scene is no longer as it was fetched; all its files are read."""
    assert found.record is not None
    with meter(f"{found.folder}: checking", sum(content.size for content in found.record.files.values())) as show:
        damage = found.record.damage(found.folder, show.add)
    if not damage:
        return None
    more = f" and {_count(len(damage) - 1, 'other file')}" if damage[1:] else ""
    return (
        f"{found.folder} is not as it was fetched: {damage[0]}{more} missing or changed; move the folder away and run "
        "the same command again"
    )


def _check_space(job: Job, packages: list[Package]) -> None:
    """Raise GetError unless the disk has space for the downloads and for what the largest of them unpacks to.

    This takes archives to be as large as their content, since images are compressed already; `place_archive` reads the
    real sizes.
    """
    missing = [file for package in packages for file in package.files if not job.target(file.path).exists()]
    parts = [job.target(file.path).with_name(file.path.name + resume.PART) for file in missing]
    there = sum(part.stat().st_size for part in parts if part.exists())
    largest = max((package.size or 0 for package in packages), default=0)
    check_space(job.folder, sum(file.size or 0 for file in missing) - there + largest, "the downloads")


def _fetch_package(job: Job, package: Package) -> int:
    """Download a package and put its scenes into their places; the number of scenes."""
    if job.options.force:
        for file in package.files:
            job.target(file.path).unlink(missing_ok=True)
    place = Place(job.source, job.folder, found_scenes(job.source, job.folder), job.options.force)
    if package.root is None:
        (file,) = package.files
        with meter(package.name, file.size) as show:
            _download(job, file, show)
        placed = place_archive(place, package, job.target(file.path))
    else:
        with meter(package.name, len(package.files), "files") as show:
            for file in package.files:
                _download(job, file, lambda _: None)
                show.add(1)
        placed = place_files(place, package, {file.path: job.target(file.path) for file in package.files})
    for scene, count in placed.files.items():
        _say(f"{place.target(scene)}: {_count(count, 'file')} of {package.name}")
    for scene in placed.left:
        _say(LEFT.format(place.target(scene)))
    if not job.options.keep and not placed.left:
        _remove(job, package)
    return len(placed.files)


def _download(job: Job, file: RemoteFile, report: Callable[[int], None]) -> None:
    target = job.target(file.path)
    target.parent.mkdir(parents=True, exist_ok=True)
    if job.source.host == "Zenodo":
        resume.download(file, target, job.options.patience, report)
    else:
        drive.download(job.source, file, target, job.options.patience, report)


def _remove(job: Job, package: Package) -> None:
    """Remove the downloads of a package that is in its place."""
    if package.root is not None and package.root.parts:
        shutil.rmtree(job.target(package.root), ignore_errors=True)
    for file in package.files:
        job.target(file.path).unlink(missing_ok=True)


def _say(text: str) -> None:
    say(one_line(text))


def _say_problem(text: str) -> None:
    say(one_line(text), "problem:", stderr=True)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
