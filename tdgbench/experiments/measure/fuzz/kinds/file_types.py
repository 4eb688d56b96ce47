"""FIFOs, devices, links, sockets and folders in the place of files, and files in the place of folders."""

from __future__ import annotations

import os
import random
import shutil
import socket
from pathlib import Path

from tdgbench.experiments.measure.fuzz import cells
from tdgbench.experiments.measure.fuzz.case import Change, Programs
from tdgbench.experiments.measure.fuzz.inputs import CELL, SCENE
from tdgbench.experiments.measure.fuzz.kinds.scene import SceneKind
from tdgbench.experiments.measure.fuzz.loaded import load_scene
from tdgbench.priors import DepthEstimator
from tdgbench.priors.files import FilePrior

PLACES = (
    "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin", "sparse/0/frames.bin", "sparse/0/rigs.bin",
    "thermal/view000.png", "thermal/view003.png", "rgb/view002.jpg", "temperature.json", "depthesti/view002.npy",
    "sparse", "sparse/0", "thermal", "depthesti", ".", "../../out", "../../out/single", "../../out/single/cells",
    "../../out/single/experiment.json", "../../out/single/tables", "../../out/cache", "../../out/single/locks",
    "../../out/single/checkpoints",
)  # fmt: skip


class FileTypes(SceneKind):
    """Something that is no file in the place of one."""

    name, share, model, words = "file-types", 6, "new", ("method=msmg",)

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.outputs = False

    def prior(self) -> DepthEstimator:
        return FilePrior(None, "depth")

    def mutate(self, rng: random.Random) -> Change:
        place, (what, make, harmful) = rng.choice(PLACES), rng.choice(KINDS)
        path = Path(os.path.normpath(self.scene / place))
        is_output = place.startswith("../../out")
        self.outputs |= is_output
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        make(path)
        name = "out" if path == self.folder / "out" else path.name
        is_read = not is_output and not (self.whole and "depthesti" in place)  # the cell's method has no prior
        return Change(f"{place}: {what}", (name, path.stem, "COLMAP", SCENE), harmful and is_read)

    def run(self, programs: Programs) -> int:
        if self.outputs:
            words = [*CELL, "method=tdg", "prior=files", f"scene={SCENE}", "checkpoint=0"]
            return cells.command_and_verify(programs, words, "out/single")
        if not self.whole:
            return load_scene("data", SCENE, self.prior())
        return super().run(programs)

    def lost(self) -> str:
        return "" if self.outputs else super().lost()

    def wrong(self) -> str:
        return cells.unverified(self.folder) if self.outputs else ""


def _socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # the path of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    finally:
        os.chdir(here)


KINDS = (  # name, how to make it, whether no result can be right
    ("FIFO", os.mkfifo, True),
    ("link to /dev/zero", lambda path: path.symlink_to("/dev/zero"), True),
    ("link to /dev/random", lambda path: path.symlink_to("/dev/random"), True),
    ("link to itself", lambda path: path.symlink_to(path.name), True),
    ("dangling link", lambda path: path.symlink_to("nosuch"), False),
    ("socket", _socket, True),
    ("folder", lambda path: path.mkdir(), False),
    ("empty file", lambda path: path.touch(), False),
    ("link to an empty file", lambda path: path.symlink_to("/dev/null"), True),
)
