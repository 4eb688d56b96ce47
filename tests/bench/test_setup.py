from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from tdgbench.bench.setup import SetupObserver, _read_images, loader_of, set_up
from tdgbench.cells.key import flat
from tdgbench.scenes import SceneError
from tdgbench.training.skips import Skips
from tests.helpers.configs import SMALL, config


def test_gray_scenes_have_three_channels_without_the_skip(data_root):
    cfg = config(*SMALL, f"data.root={data_root}", "scene=turntable")
    channels = [instantiate(loader_of(cfg, Skips(gray=on))).load(cfg.scene).channels for on in (True, False)]
    assert channels == [1, 3] and cfg.dataset.loader.options.channels == "auto"
    twice = config("dataset=drifting", f"data.root={data_root}")
    twice.dataset.loader.inner = twice.dataset.loader.copy()
    assert loader_of(twice, Skips(gray=False)).inner.inner.options.channels == 3
    forced = config(*SMALL, f"data.root={data_root}", "scene=turntable", "data.channels=1")
    assert loader_of(forced, Skips(gray=False)).options.channels == 1


def test_an_image_that_is_not_its_camera_s_is_named(small_gray_scene):
    view = small_gray_scene.test[0]
    spoilt = view.thermal.copy()
    spoilt[3, 4] = np.nan
    cut = r"is \(35, 48, 1\), by its camera it is \(36, 48, 1\)"
    for image, said in ((spoilt, "is not finite in 1 of 1728 values"), (view.thermal[1:], cut)):
        scene = replace(small_gray_scene, test=[view.with_thermal(image)])
        with pytest.raises(SceneError, match=f"the thermal image of view {view.name} of .* {said}"):
            _read_images(scene, Mock(), Skips())


class Watch(SetupObserver):
    def __init__(self):
        self.phases, self.counts, self.notes = [], [], []

    @contextmanager
    def phase(self, name):
        self.phases.append(name)
        yield

    def count(self, done, total):
        self.counts.append((done, total))

    def note(self, field, facts, notes=()):
        self.notes.append((field, facts["kind"]))


def test_an_observer_sees_phases_and_facts(data_root, tmp_path):
    cfg = config(*SMALL, f"data.root={data_root}", "scene=turntable", "prior=synthetic", "budget=demo")
    scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    first, again, watch = Skips(), Skips(), Watch()
    set_up(cfg, scene, skips=first, prior_cache=tmp_path, compiles=False)
    set_up(cfg, scene, skips=again, prior_cache=tmp_path, observer=watch)
    assert watch.phases == ["images", "prior", "init", "compile", "init"]
    assert watch.counts[-1] == (len(scene.train), len(scene.train)) and watch.notes == [
        ("prior", "depth"),
        ("init_points", "colmap"),
    ]
    assert not first.prior.taken and again.prior.saved == f"{len(scene.train)} estimates"
    assert again.rgb.taken and again.rgb.reason == "the method trains on thermal images alone"


@pytest.mark.parametrize(
    "words",
    [("init=random",), ("init=random_released",), ("init=random_box",), ("prior=synthetic",), ("prior=marigold",),
     ("dataset=drifting",)],
)  # fmt: skip
def test_what_draws_has_the_seed_of_the_cell(words):
    group = words[0].partition("=")[0]
    options = flat(OmegaConf.to_container(config(*words, "seed=3")[group], resolve=True))
    assert [value for name, value in options.items() if name.rpartition(".")[2] == "seed"] == [3]
