import numpy as np

from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.scenes import small_dataset


def test_scenes_cover_the_paper_s_groups(data_root):
    others = ("field", "hills", "wall", "half_seen")
    scenes = {name: small_dataset(data_root).load(name) for name in WORLDS if name not in others}
    assert {s.group for s in scenes.values()} == {"day", "dark", "360", "forward"}
    assert {n: s.channels for n, s in scenes.items()} == {"orbit": 3, "night": 3, "turntable": 1, "facade": 1}
    brightness = {n: s.train[0].rgb.mean() for n, s in scenes.items()}
    assert brightness["night"] < 0.05 < brightness["orbit"]


def test_half_seen_is_trained_and_reconstructed_from_one_side_and_tested_from_both(data_root):
    scene = small_dataset(data_root).load("half_seen")
    sides = {part: [view.camera.center[1] for view in getattr(scene, part)] for part in ("train", "test")}
    assert max(sides["train"]) < 0 and min(sides["test"]) < -5 and max(sides["test"]) > 5
    points = scene.points.points
    on_house = (np.abs(points[:, 0]) < 1.7) & (points[:, 2] > 0.1) & (points[:, 2] < 2.1)
    front, back = (np.sum(on_house & (np.abs(points[:, 1] - y) < 0.1)) for y in (-1.3, 1.3))
    assert front > 20 and back < 0.1 * front
