"""Fetch a data set: list, compare with what is there, download, unpack; each scene is put in place whole."""

from __future__ import annotations

import errno
import glob
import hashlib
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path, PurePosixPath

import gdown

from tdgbench.bench.lock import file_lock
from tdgbench.data.get.archives import File, archive_files, readable, stem
from tdgbench.data.get.listing import (
    AGENT,
    FAILURES,
    TIMEOUT,
    ZENODO,
    Listing,
    Package,
    RemoteFile,
    chosen,
    list_files,
    reason_of,
    sort_out,
)
from tdgbench.data.get.scenes import FoundScene, SceneRecord, by_scene, found_scenes
from tdgbench.data.get.sources import BadFileError, GetError, PublishedDataset
from tdgbench.data.progress import Count, amount, step
from tdgbench.files import whole_folder
from tdgbench.terminal import say
from tdgbench.text import one_line

DOWNLOADS = ".get"  # folder of downloads in the folder of the data set; hidden, so that it is no scene
RETRIES = 5  # after a cut connection; gdown waits longer and longer between them
FULL = (errno.ENOSPC, errno.EDQUOT)


class State(Enum):
    """Whether a package is there."""

    MISSING = "to be fetched"
    THERE = "there"
    LEFT = "there, but not fetched by this command, or in another version"


@dataclass(frozen=True)
class Download:
    """The download of one data set into `folder`.

    scenes: names; empty: all. force: fetch and replace what is there. keep: keep archives. zenodo: address of Zenodo.
    """

    source: PublishedDataset
    folder: Path
    scenes: tuple[str, ...] = ()
    force: bool = False
    keep: bool = False
    zenodo: str = ZENODO

    @property
    def downloads(self) -> Path:
        return self.folder / DOWNLOADS

    def target(self, path: PurePosixPath) -> Path:
        """Return where a published file is downloaded to."""
        return self.downloads / path

    def listing(self) -> Listing:
        """Return what is published, without scenes that were not asked for. Raises GetError."""
        packages, others = sort_out(self.source, list_files(self.source, self.zenodo))
        return Listing(chosen(self.source, packages, self.scenes), others)

    def state(self, package: Package, there: Mapping[str, FoundScene]) -> State:
        """Return whether a package is among the scenes that are there; with `force`, it never is."""
        made = [found.record for found in there.values() if found.is_made_of(package.identities) and found.record]
        if self.force or (made and not all(scene in there for scene in made[0].scenes)):
            return State.MISSING
        if made:
            return State.THERE
        return State.LEFT if package.scene in there else State.MISSING


def fetch(job: Download) -> bool:
    """Fetch a data set and say what was done; return whether all that is published is there at the end.

    Raises GetError and OSError for what stops the whole download; a file that cannot be used does not. What was
    downloaded is kept then, and the same call goes on from it. An interruption has a note that says so.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    with file_lock(job.downloads / ".lock") as acquired:
        if not acquired:
            raise GetError(f"another process is fetching into {job.folder}; wait for its end")
        try:
            return _fetch(job, job.listing())
        except OSError as error:
            if error.errno not in FULL:
                raise
            raise GetError(f"the disk of {job.folder} is full: {_kept(job)}; free some space first") from error
        except KeyboardInterrupt as interruption:
            interruption.add_note(_kept(job))
            raise


def _kept(job: Download) -> str:
    """Return what an unfinished download leaves on disk."""
    size = sum(path.stat().st_size for path in job.downloads.rglob("*") if path.is_file())
    return f"{job.downloads} keeps {amount(size)} of downloads; the same command goes on from there"


def _fetch(job: Download, found: Listing) -> bool:
    there = found_scenes(job.source, job.folder)
    states = {package: job.state(package, there) for package in found.packages}
    missing = [package for package, state in states.items() if state is State.MISSING]
    if found.others:
        _say(f"not fetched: {', '.join(map(str, found.others))} ({job.source.page}; scenes belong into {job.folder})")
    for package, state in states.items():
        if state is State.LEFT and package.scene:
            _say_left(there[package.scene].folder)
    fetched, problems = 0, 0
    for package in missing:
        try:
            fetched += _fetch_package(job, package)
        except BadFileError as error:
            say(one_line(str(error)), "problem:", stderr=True)
            problems += 1
    before = [package.identities for package, state in states.items() if state is State.THERE]
    whole = sum(any(map(found.is_made_of, before)) for found in there.values())
    end = _count(problems, "problem") if problems else f"{_count(whole, 'scene')} already there"
    _say(f"{job.folder}: {_count(fetched, 'scene')} fetched, {end}")
    return not problems


def _fetch_package(job: Download, package: Package) -> int:
    """Download a package and put its scenes into their places; return the number of scenes."""
    if job.force:
        _remove(job, package)
    is_archive = package.root is None
    with step(package.name, package.size if is_archive else len(package.files), is_archive) as report:
        for number, file in enumerate(package.files, 1):
            download(file, job.target(file.path), report if is_archive else lambda _: None)
            if not is_archive:
                report(number)
    placed, left = _put_in_place(job, package)
    for folder in left:
        _say_left(folder)
    if not job.keep and not left:
        _remove(job, package)
    return placed


def download(file: RemoteFile, target: Path, report: Count) -> None:
    """Download a file through gdown to `target`, unless it is there, and check its MD5 if that is published.

    gdown continues partial files and tries again after a cut connection; pooch begins each file anew.
    report: called with the number of bytes that are there. Raises GetError, OSError; BadFileError, with both sums, if
    the content is not what was published: it is discarded then.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    for part in partial_files(target):
        if file.size is not None and part.stat().st_size >= file.size:  # gdown would ask for what follows
            part.replace(target)
    if not target.is_file():
        _fetch_file(file, target, report)
    if file.identity.startswith("md5:"):
        with target.open("rb") as content:
            found = f"md5:{hashlib.file_digest(content, 'md5').hexdigest()}"
        if found != file.identity:
            target.unlink()
            raise BadFileError(
                f"{file.path} is damaged: its {found}, published is {file.identity}; it was discarded: run the command "
                "again, which downloads it anew"
            )


def partial_files(target: Path) -> list[Path]:
    """Return what gdown keeps of an unfinished download."""
    return list(target.parent.glob(f"{glob.escape(target.name)}????????.part"))


def _fetch_file(file: RemoteFile, target: Path, report: Count) -> None:
    agent = AGENT if file.size is not None else None  # Google answers only browsers, as which gdown poses
    try:
        gdown.download(
            url=file.address, output=str(target), quiet=True, use_cookies=False, resume=True, timeout=TIMEOUT,
            retries=RETRIES, user_agent=agent, progress=lambda there, _: report(there),
        )  # fmt: skip
    except FAILURES as error:
        raise GetError(
            f"{file.path} cannot be fetched: {reason_of(error)}; what is there is kept, and the same command goes on "
            "from it (--force begins anew)"
        ) from error


def _put_in_place(job: Download, package: Package) -> tuple[int, list[Path]]:
    """Unpack a package and put scenes that are not there yet into their places, or all with `force`.

    Returns their number, and folders of scenes of other origin that were left as they are. Raises BadFileError if an
    archive is refused or damaged: nothing of it is in place then. Raises OSError.
    """
    there = found_scenes(job.source, job.folder)
    unpacked = job.downloads / ".unpacked"
    shutil.rmtree(unpacked, ignore_errors=True)
    try:
        paths = _unpack(job, package, unpacked)
        scenes = by_scene(job.source, paths, stem(PurePosixPath(package.name).name) or package.name, package.name)
        if not scenes:
            raise BadFileError(
                f"{package.name} holds no scene: no folder with sparse/, rgb/, thermal/ or transforms.json"
            )
        free = {name: root for name, root in scenes.items() if job.force or name not in there}
        for name, root in free.items():
            folder = there[name].folder if name in there else job.folder / name
            with whole_folder(folder) as part:
                for path in (unpacked / root).iterdir():
                    path.replace(part / path.name)
                SceneRecord(job.source.page, package.identities, list(scenes)).write(part)
            _say(f"{folder}: {_count(sum(root in path.parents for path in paths), 'file')} of {package.name}")
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)
    others = [there[name] for name in scenes if name not in free]
    return len(free), [found.folder for found in others if not found.is_made_of(package.identities)]


def _unpack(job: Download, package: Package, folder: Path) -> list[PurePosixPath]:
    """Copy the files of a package into a folder; return their paths in it."""
    paths = []
    with readable(job.target(package.files[0].path)):
        for file in _files(job, package):
            target = folder / file.path
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as out:
                shutil.copyfileobj(file.content, out)
            if target.stat().st_size != file.size:
                raise EOFError(f"{file.path} has not the {file.size} bytes that it declares")
            paths.append(file.path)
    return paths


def _files(job: Download, package: Package) -> Iterator[File]:
    """Yield the files of a package that is downloaded."""
    if package.root is None:
        yield from archive_files(job.target(package.files[0].path))
        return
    for file in package.files:
        path = job.target(file.path)
        with path.open("rb") as content:
            yield File(file.path, path.stat().st_size, content)


def _remove(job: Download, package: Package) -> None:
    """Remove what was downloaded of a package."""
    for file in package.files:
        for path in (job.target(file.path), *partial_files(job.target(file.path))):
            path.unlink(missing_ok=True)


def _say(text: str) -> None:
    say(one_line(text))


def _say_left(folder: Path) -> None:
    _say(f"{folder} is left as it is: this command did not fetch it, or another version (--force replaces it)")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
