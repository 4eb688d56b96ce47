"""The suite finds every kind of defect: deliberately broken loaders, one per outcome."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time

import pytest

from benchmarks.fuzz.__main__ import counts, line
from benchmarks.fuzz.case import Change
from benchmarks.fuzz.kinds import scene as scenes
from benchmarks.fuzz.kinds.arrays import Celsius
from benchmarks.fuzz.kinds.colmap import NewColmap, OldColmap, TextColmap
from benchmarks.fuzz.suite import Drawn, draw
from tdgbench.scenes import FolderDataset, SceneError


class Loaded(OldColmap):
    """A model without mutation, which is only loaded."""

    def __init__(self, base, folder, rng):
        super().__init__(base, folder, random.Random(1))
        assert not self.whole

    def mutate(self, rng):
        return Change("nothing", ("cameras.bin",))


def outcome(suite, kind=Loaded):
    (finding,) = suite.run([Drawn(0, 1, kind, (0,))], 1)
    return finding.outcome


def broken(monkeypatch, after):
    """Replace the loader by one that does something with the scene it loaded."""
    load = FolderDataset.load
    monkeypatch.setattr(FolderDataset, "load", lambda self, name: after(load(self, name)))


def _error(message):
    raise SceneError(message)


def _other_focal_length(scene):
    scene.train[0].camera.K[0, 0] *= 1.01
    return scene


def _no_points(scene):
    object.__setattr__(scene, "points", type(scene.points)(scene.points.points[:-1], scene.points.colors[:-1]))
    return scene


def _other_pose(scene):
    scene.train[1].camera.world_to_camera[0, 3] += 1e-3
    return scene


DEFECTS = {
    "hang": ("hang", lambda scene: time.sleep(60)),
    "memory": ("memory", lambda scene: [b"x" * 10_000_000 for _ in range(10_000)]),
    "crash": ("crash", lambda scene: os.kill(os.getpid(), signal.SIGSEGV)),
    "traceback": ("traceback", lambda scene: {}["key"]),
    "unnamed": ("unnamed", lambda scene: _error("something is wrong")),
    "error": ("error", lambda scene: _error("sparse/0/cameras.bin is cut off; copy it again")),
    "exit-0": ("exit-0", lambda scene: print("failed: cameras.bin", file=sys.stderr) or scene),
    "focal length": ("wrong", _other_focal_length),
    "points": ("wrong", _no_points),
    "pose": ("wrong", _other_pose),
    "sound": ("result", lambda scene: scene),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_every_defect_of_a_loader_is_found(suite, monkeypatch, name):
    expected, after = DEFECTS[name]
    broken(monkeypatch, after)
    if expected == "hang":
        suite.limits = suite.limits._replace(seconds=1)
    assert outcome(suite) == expected


@pytest.mark.parametrize("kind", [OldColmap, NewColmap, TextColmap])
def test_good_models_load(suite, kind, monkeypatch):
    monkeypatch.setattr(kind, "mutate", lambda self, rng: Change("nothing", ()))
    monkeypatch.setattr(scenes, "WHOLE", 0.0)
    assert outcome(suite, kind) == "result"


def test_a_case_is_decided_by_seed_and_number():
    drawn = [draw(5, number) for number in range(300)]
    assert drawn == [draw(5, number) for number in range(300)] != [draw(6, number) for number in range(300)]
    assert len({one.kind for one in drawn}) > 10 and {len(one.mutations) for one in drawn} == {1, 2, 3}


def test_a_case_that_breaks_is_shrunk_and_kept(suite, monkeypatch, tmp_path):
    class Stacked(Loaded):
        def mutate(self, rng):
            path = self.scene / "sparse" / "0" / "cameras.bin"
            harmful = path.stat().st_size > 0 and rng.random() < 0.5
            path.write_bytes(b"" if harmful else path.read_bytes())
            return Change("emptied" if harmful else "nothing", ("nothing of it",))

    drawn = next(one for one in (Drawn(0, number, Stacked, (0, 1, 2)) for number in range(100))
                 if [one.rng(m).random() < 0.5 for m in one.mutations] == [False, True, False])  # fmt: skip
    broken(monkeypatch, lambda scene: scene)
    (finding,) = suite.run([drawn], 1)
    assert finding.broke
    best = suite.shrink(finding, tmp_path / "keep")
    assert best.drawn.mutations == (1,) and best.outcome == finding.outcome
    (folder,) = (tmp_path / "keep").iterdir()
    case = json.loads((folder / "case.json").read_text())
    assert case["mutations"] == ["emptied"] and (folder / "data/garden/sparse/0/cameras.bin").read_bytes() == b""
    assert "1 of 1 cases broke" in counts([best]) and line(best).startswith(finding.outcome)


def test_a_mutation_that_an_earlier_one_made_impossible_is_left_out(suite, monkeypatch):
    """np.load of an emptied array raises EOFError, which once ended the whole suite."""

    class Emptied(Celsius):
        emptied = False

        def mutate(self, rng):
            if self.emptied:
                return super().mutate(rng)
            self.emptied = True
            for path in self.arrays.iterdir():
                path.write_bytes(b"")
            return Change("emptied", ("warped_thermal",))

    monkeypatch.setattr(scenes, "WHOLE", 0.0)
    findings = list(suite.run((Drawn(0, number, Emptied, (0, 1)) for number in range(8)), 2))
    assert len(findings) == 8 and "nothing" in {finding.changes[1].text for finding in findings}
