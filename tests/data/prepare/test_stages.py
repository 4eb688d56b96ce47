import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.children import with_path
from tdgbench.data.folders import Stages
from tdgbench.data.prepare import prepare, sfm
from tests.helpers.command import tdgbench_here
from tests.helpers.paths import ROOT
from tests.helpers.relief import FOCAL, places, write_relief
from tests.helpers.waiting import waited

COMMAND = ("data", "prepare", "camera", "out", "--sfm", "thermal", "--focal", str(FOCAL), "--threads", "1")
STEPS = "files to read", "features of images", "pairs of images to match", "images to register", "views to write"


def test_a_changed_input_starts_again_from_its_stage(tmp_path):
    made = []

    def run(first, second):
        stages = Stages(tmp_path / "work")
        for name, inputs in (("first", first), ("second", second)):
            place = stages.make(name, inputs, lambda place, name=name: made.append(name) or (place / name).touch())
            assert (place / name).exists()

    run(1, 1)
    run(1, 1)
    assert made == ["first", "second"]
    run(1, 2)
    assert made == ["first", "second", "second"]
    run(2, 2)
    assert made[3:] == ["first", "second"] and len(list((tmp_path / "work").iterdir())) == 2
    with pytest.raises(ZeroDivisionError):
        Stages(tmp_path / "work").make("first", 3, lambda place: 1 / 0)
    assert [path.name.split("-")[0] for path in (tmp_path / "work").iterdir()] == ["second"]


def test_an_interrupted_run_says_that_it_can_go_on(tmp_path, monkeypatch):
    def interrupted(folder, part, stages, *_):
        stages.make("first", 1, lambda place: None)
        raise KeyboardInterrupt

    monkeypatch.setattr(prepare, "_prepare", interrupted)
    with pytest.raises(KeyboardInterrupt) as error:
        prepare.prepare_scene(tmp_path, tmp_path / "out", prepare.PrepareOptions())
    assert error.value.__notes__ == ["the same command goes on after the last finished stage"]


def test_pairs_that_are_matched_stay_when_a_run_is_stopped(tmp_path, monkeypatch):
    """Stopped in the second batch of pairs, it goes on with that one; features are not extracted again."""
    (tmp_path / "images").mkdir()
    names = [f"{index}.png" for index in range(4)]
    for name, levels in zip(names, np.random.default_rng(0).integers(0, 255, (4, 120, 160), np.uint8), strict=True):
        Image.fromarray(levels).save(tmp_path / "images" / name)
    batches, match = [], pycolmap.match_image_pairs

    def matching(database, settings, pairing, *rest):
        batches.append(Path(pairing.match_list_path).read_text().split("\n")[:-1])
        if len(batches) == 2:
            raise KeyboardInterrupt
        match(database, settings, pairing, *rest)

    monkeypatch.setattr(sfm, "PAIRS_AT_A_TIME", 4)
    monkeypatch.setattr(pycolmap, "match_image_pairs", matching)
    for _ in range(2):
        with suppress(KeyboardInterrupt):
            database = sfm.matched(tmp_path / "images", names, Stages(tmp_path / "work"), sfm.SfmOptions(threads=1))
        monkeypatch.setattr(pycolmap, "extract_features", None)
    first, stopped, last = batches
    assert len(first) == 4 and len(last) == 2 and stopped == last
    with pycolmap.Database.open(database) as stored:
        assert stored.num_verified_image_pairs() == 6


@pytest.mark.slow
def test_killed_at_five_moments_it_ends_with_the_same_bytes(tmp_path):
    """Each run is killed in a later step than the one before. None repeats a finished step or a matched pair."""
    for name in ("killed", "whole"):
        write_relief(tmp_path / name / "camera", places(4, 3))
    pairs = [begun_until(step, tmp_path / "killed", STEPS[max(index - 1, 0) : index + 1])
             for index, step in enumerate(STEPS)]  # fmt: skip
    assert pairs[2] == 66 and pairs[3] <= 66 - 64
    content = {}
    for name, begun in (("killed", STEPS[4:]), ("whole", STEPS)):
        run = tdgbench_here(tmp_path / name, *COMMAND)
        assert run.returncode == 0, run.stderr
        assert [step for step in STEPS if f"{step}: " in run.stdout] == list(begun)
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == [".out.lock", "camera", "out"]
        files = (path for path in (tmp_path / name / "out").rglob("*") if path.is_file())
        content[name] = {str(path.relative_to(tmp_path / name)): path.read_bytes() for path in files}
    assert content["killed"] == content["whole"] and len(content["killed"]) > 12
    assert "COLMAP registers 12 images" in content["killed"]["out/report.txt"].decode()


def begun_until(step, folder, expected):
    """Run the command until it is in the step; kill it. Return the number of pairs to match, if it begins with them."""
    found, pairs = [], None
    environment = with_path(ROOT)
    with subprocess.Popen([sys.executable, "-m", "tdgbench", *COMMAND], cwd=folder, env=environment,
                          stdout=subprocess.PIPE, text=True) as run:  # fmt: skip
        for line in run.stdout:
            name, _, what = line.strip().partition(": ")
            if name in STEPS and not what.startswith("done"):
                found.append(name)
                pairs = int(what) if name == STEPS[2] else pairs
            if name == step:
                if step == STEPS[2]:
                    waited(lambda: in_second_batch(folder), 60, "a second batch of pairs")
                run.kill()
                break
    assert run.returncode == -signal.SIGKILL and found == list(expected)
    return pairs


def in_second_batch(folder):
    lists = [path.read_text(encoding="utf-8") for path in folder.glob(".out.work/matches-*/pairs.txt")]
    return any(lists) and not lists[0].startswith("000000.png 000001.png")
