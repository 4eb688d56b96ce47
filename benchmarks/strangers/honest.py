"""Honest files, from which hostile ones are made: a pack with two small cells, and a scene in two layouts."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.strangers.server import Server

Files = dict[str, bytes]  # by relative path
TRAINING = (
    "-m", "scene=orbit", "dataset.loader.width=32", "dataset.loader.height=24",
    "dataset.loader.views=6", "dataset.loader.points=100", "prior=synthetic", "budget=demo", "budget.iterations=20",
    "metrics.lpips.download=false", "checkpoint=null", "data.root=data", "results=results", "name=honest",
)  # fmt: skip
CELLS = (("method=3dgs", "thermal_camera.rig=true"), ("method=msmg", "thermal_camera.rig=false"))
WITH_PARTS, WITHOUT_PARTS = (f"cells/{method}/synthetic/orbit/colmap/seed0" for method in ("3dgs", "msmg"))
WARM = (
    ("verify", "honest.zip"), ("compare", "honest.zip", "honest.zip", "--out", "compared"), ("tables", "theirs"),
    ("site", "honest.zip", "pages"), ("score", "honest.zip", "scored", "metrics.lpips.download=false"),
    ("data", "check", "scenes"),
)  # fmt: skip


@dataclass(frozen=True)
class Honest:
    """pack: files of a pack, its manifest left out, by name. scenes: files of a scene by layout. folder: of all."""

    pack: Files
    scenes: dict[str, Files]
    folder: Path


def make_honest(server: Server, folder: Path) -> Honest:
    """Train the cells and write the scene in a new folder, and warm the server with them.

    Raises RuntimeError if a tool fails on honest files.
    """
    folder.mkdir()
    for cell in CELLS:
        _run(server, folder, (*TRAINING, *cell))
    _run(server, folder, ("pack", "results/honest", "--out", "honest.zip", "--keep-paths"))
    _run(server, folder, ("unpack", "honest.zip", "theirs"))
    (scene,) = (folder / "data" / "synthetic").iterdir()
    for layout in ("3dgs", "nerfstudio"):
        _run(server, folder, ("data", "export", str(scene), f"scenes/{layout}", "--format", layout))
    for words in WARM:
        _run(server, folder, words, "warm")
    with zipfile.ZipFile(folder / "honest.zip") as archive:
        pack = {name: archive.read(name) for name in archive.namelist() if name != "manifest.json"}
    scenes = {}
    for layout in ("3dgs", "nerfstudio"):
        place = folder / "scenes" / layout
        files = [path for path in sorted(place.rglob("*")) if path.is_file()]
        scenes[layout] = {path.relative_to(place).as_posix(): path.read_bytes() for path in files}
    return Honest(pack, scenes, folder)


def _run(server: Server, folder: Path, words: tuple[str, ...], how: str = "trusted") -> None:
    outcome = server.run(list(words), folder, how)
    if outcome.status != 0:
        raise RuntimeError(f"{' '.join(words)} fails on honest files:\n{outcome.output}{outcome.error}")
