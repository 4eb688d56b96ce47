from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.scenes import small_dataset


def test_scenes_cover_the_paper_s_groups(data_root):
    scenes = {name: small_dataset(data_root).load(name) for name in WORLDS if name not in ("field", "hills", "wall")}
    assert {s.group for s in scenes.values()} == {"day", "dark", "360", "forward"}
    assert {n: s.channels for n, s in scenes.items()} == {"orbit": 3, "night": 3, "turntable": 1, "facade": 1}
    brightness = {n: s.train[0].rgb.mean() for n, s in scenes.items()}
    assert brightness["night"] < 0.05 < brightness["orbit"]
