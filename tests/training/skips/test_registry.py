import copy
from types import SimpleNamespace

import pytest
from hydra.utils import instantiate

from tdgbench.training import skips as package
from tdgbench.training.skips import Skips
from tdgbench.training.skips.account import note_training
from tests.helpers.configs import config

NAMES = ["gray", "rgb", "prior", "depth", "unseen", "saturated", "growth", "pixels", "settling", "plateau"]
MADE_UP = """
from tdgbench.training.skips.skip import Skip


class Night(Skip):
    order = 15

    def account(self, training):
        self.decide(training.scene.dark, "the scene is dark", "everything")
"""


def test_all_skips_have_names():
    skips = Skips().all()
    assert [s.name for s in skips] == NAMES
    assert all(s.allowed and not s.taken for s in skips)
    assert [s.name for s in copy.deepcopy(Skips(gray=False)).all() if not s.allowed] == ["gray"]


def test_an_unknown_skip_is_named():
    with pytest.raises(ValueError, match="there is no skip grey; there are gray, rgb"):
        Skips(grey=False)
    with pytest.raises(AttributeError, match="there is no skip grey"):
        Skips().grey.decide(True, "", "")


def test_configurations():
    assert list(config().skip) == ["_target_", *NAMES]
    assert all(skip.allowed for skip in instantiate(config().skip).all())
    assert not any(skip.allowed for skip in instantiate(config("skip=none").skip).all())
    off = [skip.name for skip in instantiate(config("skip.gray=false").skip).all() if not skip.allowed]
    on = [skip.name for skip in instantiate(config("skip=none", "+skip.depth=true").skip).all() if skip.allowed]
    assert (off, on) == (["gray"], ["depth"])


def test_a_file_is_a_skip(tmp_path, monkeypatch, small_gray_scene):
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    (tmp_path / "night.py").write_text(MADE_UP)
    assert [skip.name for skip in Skips(night=False).all()] == ["gray", "night", *NAMES[1:]]
    skips = Skips()
    for name in NAMES:
        delattr(skips, name)
    note_training(skips, SimpleNamespace(dark=True), None, None, None)
    assert (skips.night.taken, skips.night.reason, skips.night.saved) == (True, "the scene is dark", "everything")
