from contextlib import contextmanager

from hydra.utils import instantiate

from tdgbench.bench.setup import SetupObserver, loader_of, set_up
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
