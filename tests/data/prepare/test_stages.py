from contextlib import suppress
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.data.prepare import prepare, sfm
from tdgbench.data.prepare.stages import Stages


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
