"""Names as people and file systems give them, and FIFOs, devices, links and folders in the place of files."""

from __future__ import annotations

import csv
import os
import random
import re
import shutil
import socket
from pathlib import Path
from typing import ClassVar

from benchmarks.fuzz import cells
from benchmarks.fuzz.case import Change, Kind, Programs
from benchmarks.fuzz.colmap_files import read_binary, write_binary
from benchmarks.fuzz.inputs import CELL, SCENE, copy_scene
from benchmarks.fuzz.kinds.scene import SceneKind, load_scene
from tdgbench.priors import DepthEstimator
from tdgbench.priors.files import FilePrior

ORDINARY = ("1", "2", "2024", "a b", "a_b", "a-b", "A B", "Truck", "ä", "日本")  # an error is no answer to these
NAMES = (
    *ORDINARY, "007", "null", "true", "nan", "1e5", "0x1", "None", "average", "Average", "CON", "-x", "~", " lead",
    "trail ", "a,b", "a=b", "a:b", "a;b", "(a)", "{a}", "a\\b", "*", "?", "'", '"', "$x", "${x}", "_", "%", "50%", "#",
    "&", "=1+1", "+1", "@x", "[red]", "[/red]", "<script>x</script>", ".hidden", "...", "a\nb", "a\tb", "\x1b[31m",
    "\u202eabc", "e\u0301", "\u00e9", "a" * 250,
)  # fmt: skip
TEX = set("%$_&#{}~^\\")


class SceneNames(Kind):
    """A sweep over two scenes whose folders have unusual names."""

    name: ClassVar[str] = "names"
    share = 4

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        self.scenes, self.experiment, self.results = ["plain", "other"], "single", "out"
        self.views: dict[str, str] = {}
        self.words = self._words()

    def mutate(self, rng: random.Random) -> Change:
        change = self._rename(rng)
        self.words = self._words()
        return change

    def _rename(self, rng: random.Random) -> Change:
        name, what = rng.choice(NAMES), rng.random()
        names = (name, repr(name)[1:-1], name.split("\n")[0] or name)
        if what < 0.6:
            index = rng.randrange(2)
            if name in self.scenes:
                return Change("nothing", names)
            self.scenes[index] = name
            return Change(f"scene {name!r}", (*names, "scene"))
        if what < 0.75:
            self.experiment = name
            return Change(f"name={name!r}", (*names, "name"))
        if what < 0.85:
            self.results = name
            return Change(f"results={name!r}", (*names, "results"))
        view = name.replace("/", "-")  # one file's name
        self.views[rng.choice(("view000", "view001", "view002"))] = view
        return Change(f"view {view!r}", (view, repr(view)[1:-1], "view"))

    def run(self, programs: Programs) -> int:
        for scene in self.scenes:
            copy_scene(self.base, Path("data", scene))
            self._rename_views(Path("data", scene))
        return cells.command_and_verify(programs, list(self.words), f"{self.results}/{self.experiment}")

    def _words(self) -> list[str]:
        """The arguments, quoted as Hydra wants it."""
        scenes, name, results = map(quoted, self.scenes), quoted(self.experiment), quoted(self.results)
        words = [word for word in CELL if not word.startswith("results=")]
        return ["-m", *words, "method=3dgs", f"scene={','.join(scenes)}", f"name={name}", f"results={results}"]

    def _rename_views(self, scene: Path) -> None:
        model = read_binary(scene / "sparse" / "0")
        for old, new in self.views.items():
            for path in (scene / "thermal" / f"{old}.png", scene / "rgb" / f"{old}.jpg"):
                path.rename(path.with_name(f"{new}{path.suffix}"))
            for image in model.images:
                if image.view == old:
                    image.name = f"{new}.png"
        write_binary(scene / "sparse" / "0", model)

    def refused(self) -> str:
        chosen = {*self.scenes, self.experiment, self.results, *self.views.values()}
        return "refuses ordinary names" if chosen <= {*ORDINARY, "plain", "other", "single", "out"} else ""

    def wrong(self) -> str:
        experiment = self.folder / self.results / self.experiment
        done = sorted(str(one.get("scene")) for one in cells.records(experiment) if one.get("status") == "ok")
        if done != sorted(self.scenes):
            return f"records of {done} for scenes {sorted(self.scenes)}"
        return cells.unverified(self.folder) or _wrong_outputs(experiment, self.scenes)


def _wrong_outputs(experiment: Path, scenes: list[str]) -> str:
    """Names that a table or the report shows wrongly, or that another program would run."""
    if "<script>x</script>" in (experiment / "report.html").read_text(encoding="utf-8"):
        return "the report holds a script"
    with (experiment / "tables" / "main.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if any(str(value).startswith(("=", "+", "@")) for row in rows for value in row.values()):
        return "main.csv holds a formula"
    if sum(row["scene"] not in ("Average", "Overall") for row in rows) % len(scenes):
        return "main.csv has rows of other scenes"
    tex = "".join(path.read_text(encoding="utf-8") for path in (experiment / "tables").glob("*.tex"))
    tex = re.sub(r"\\[$_%#&{}]", "", tex)  # what is escaped
    raw = [scene for scene in scenes if TEX & set(scene) and scene in tex and len(scene) > 1]
    return f"LaTeX tables hold {raw[0]!r}" if raw else ""


def quoted(name: str) -> str:
    """A value in Hydra's quotes."""
    return "'" + name.replace("\\'", "\\\\'").replace("'", "\\'") + "'"


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
