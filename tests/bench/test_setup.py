from hydra.utils import instantiate

from tdgbench.bench.setup import loader_of, set_up
from tdgbench.training.loop import train
from tdgbench.training.skips import Skips
from tests.conftest import SMALL, config


def test_gray_scenes_have_three_channels_without_the_skip(data_root):
    cfg = config(*SMALL, f"data.root={data_root}", "scene=turntable")
    channels = [instantiate(loader_of(cfg, Skips(gray=on))).load(cfg.scene).channels for on in (True, False)]
    assert channels == [1, 3] and cfg.dataset.loader.options.channels == "auto"
    forced = config(*SMALL, f"data.root={data_root}", "scene=turntable", "data.channels=1")
    assert loader_of(forced, Skips(gray=False)).options.channels == 1


def test_a_method_ready_to_train(data_root):
    cfg = config(*SMALL, f"data.root={data_root}", "scene=turntable", "prior=synthetic", "budget=demo")
    scene, budget = instantiate(cfg.dataset.loader).load(cfg.scene), instantiate(cfg.budget)
    method = set_up(instantiate(cfg.method.method), cfg, scene, budget, "auto")
    assert len(method.models()["thermal"]) == 300 and len(method.targets) == len(scene.train)
    assert train(method, 2).iterations == 2
