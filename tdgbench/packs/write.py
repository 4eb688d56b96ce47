"""Write a pack: the plan of an experiment and its cells in one zip file, whose bytes its content alone decides."""

from __future__ import annotations

import hashlib
import io
import json
import shlex
import shutil
import zipfile
from collections.abc import Iterable
from pathlib import Path, PureWindowsPath
from typing import Any

from tdgbench import __version__
from tdgbench.cells.folder import files_below
from tdgbench.cells.key import flat
from tdgbench.cells.paths import RECORD_FILE
from tdgbench.cells.plan import PLAN_FILE
from tdgbench.cells.record import no_records, record_files
from tdgbench.files import content_of, opened, whole_file
from tdgbench.packs import manifest
from tdgbench.packs.manifest import MANIFEST_FILE, PackedFile
from tdgbench.scenes import SceneError
from tdgbench.text import absolute_paths, as_typed

EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file: the first time that a zip file can state
TEXTS = (".json", ".csv")
COMPRESSED = (*TEXTS, ".ply", ".pt")  # PNG is


def pack(experiment: Path, path: Path | None = None, keep_paths: bool = False) -> tuple[Path, str]:
    """Pack an experiment's folder; return the file's path and the pack's hash.

    path: default <experiment>-<hash>.zip beside the folder. Tracebacks of failed cells are left out: they name folders.
    keep_paths: whether other absolute paths may stay. Raises ValueError, naming a file, if one has such a path or is no
    regular file, if the pack's name does not end in .zip, and if there are no records.
    """
    if path is not None and path.suffix != ".zip":  # what is there is replaced
        raise ValueError(f"--out {path}: the file's name must end in .zip")
    paths, experiment_name = _paths(experiment), experiment.resolve().name
    if not keep_paths:
        _check_no_private_paths([file for name, file in paths.items() if name.endswith(TEXTS)], experiment)
    files = {name: _described(file, experiment) for name, file in paths.items()}
    manifest.check_amount(files)
    text = manifest.Manifest(manifest.plain_name(experiment_name), __version__, files).to_json()
    manifest.read_manifest(text)  # as its readers will
    name = manifest.sha256(text)
    path = path or experiment.resolve().parent / f"{experiment_name}-{name[: manifest.SHOWN]}.zip"
    with whole_file(path) as part, zipfile.ZipFile(part, "w") as archive:
        archive.writestr(_info(MANIFEST_FILE), text)
        for entry, file in paths.items():
            with _content(file, experiment) as content, archive.open(_info(entry, files[entry].size), "w") as out:
                shutil.copyfileobj(content, out)
    return path, name


def _check_no_private_paths(files: Iterable[Path], experiment: Path) -> None:
    """Raise ValueError for a text that holds an absolute path."""
    for file in files:
        text = _text(file)
        for found in absolute_paths(text.decode(errors="replace")):
            cure = "run the cell again with relative paths (data.root=data)"
            if file.name == RECORD_FILE:
                metrics = (json.loads(text).get("config") or {}).get("metrics") or {}
                if (metrics.get("lpips") or {}).get("weights") == found:
                    cure = _rescored(experiment, metrics)
            raise ValueError(f"{file} holds {found!r}, a path of this machine: {cure}, or pack with --keep-paths")


def _rescored(experiment: Path, metrics: dict[str, Any]) -> str:
    """Return how to have the same scores with a relative path of LPIPS's weights. metrics: options in a record."""
    weights = PureWindowsPath(metrics["lpips"]["weights"]).name
    options = {n: v for n, v in flat(metrics).items() if n.rpartition(".")[2] not in ("_target_", "weights_sha256")}
    words = [f"metrics.{name}={as_typed(value)}" for name, value in {**options, "lpips.weights": weights}.items()]
    command = ["tdgbench", "score", str(experiment), f"{experiment}-shared", *words]
    return (f"copy or link the weights to {weights} here, then pack what this writes, in seconds and without training: "
            f"{shlex.join(command)}")  # fmt: skip


def _described(file: Path, experiment: Path) -> PackedFile:
    with _content(file, experiment) as content:
        size = content.seek(0, 2)
        content.seek(0)
        return PackedFile(size, hashlib.file_digest(content, "sha256").hexdigest())


def _info(entry: str, size: int = 0) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(entry, EPOCH)
    info.external_attr, info.create_system = 0o100644 << 16, 3  # a regular file, on any system
    info.compress_type = zipfile.ZIP_DEFLATED if entry.endswith(COMPRESSED) else zipfile.ZIP_STORED
    info.file_size = size  # decides whether a member needs zip64
    return info


def _paths(experiment: Path) -> dict[str, Path]:
    """Return the files of a pack, by relative path. Raises ValueError without records."""
    records = record_files(experiment)
    if not records:
        raise no_records(experiment)
    paths = [experiment / PLAN_FILE] if (experiment / PLAN_FILE).exists() else []
    for record in records:
        paths += [record, *files_below(record.parent).values()]
    found = {}
    for path in sorted(paths):
        name = path.relative_to(experiment).as_posix()
        try:
            manifest.check_place(name)
            opened(path, manifest.most_bytes(name), inside=experiment).close()
        except (ValueError, SceneError) as error:
            raise ValueError(f"{path} cannot be packed: {error}") from error
        found[name] = path
    return found


def _content(path: Path, experiment: Path) -> io.BytesIO | io.BufferedReader:
    """Open a file of a pack; a record is without the traceback of a failure."""
    return io.BytesIO(_text(path)) if path.name == RECORD_FILE else opened(path, inside=experiment)


def _text(path: Path) -> bytes:
    """Read a text; a record is without the traceback of a failure."""
    stored = content_of(path, manifest.most_bytes(path.name))
    if path.name != RECORD_FILE:
        return stored
    try:
        content = json.loads(stored)
        if not isinstance(content, dict):
            raise ValueError("it is not a JSON object")
        if not content.get("failure"):
            return stored
        content["failure"]["traceback"] = ""
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path} cannot be packed: it is no record: {error}") from error
    return (json.dumps(content, indent=1, sort_keys=True) + "\n").encode()
