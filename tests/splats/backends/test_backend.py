"""A new backend is one module and one YAML file: a made-up one renders and trains without any other change."""

import sys

import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats import backends, rasterization
from tdgbench.splats.backends import backend_names, choose_backend, fast_backends, load_backend
from tdgbench.splats.backends.backend import Backend
from tdgbench.training.loop import train
from tdgbench.training.warmup import compile_kernels
from tests.helpers.configs import config
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.helpers.paths import ROOT
from tests.helpers.training import ready_to_train

SOURCE = """
from contextlib import contextmanager

import torch

from tdgbench.splats.backends import reference
from tdgbench.splats.backends.backend import Backend

CALLS = []


class Double(Backend):
    inputs = "float32 tensors"

    def takes(self, device, dtype):
        return dtype == torch.float32

    @contextmanager
    def compiling(self, channels, depth):
        CALLS.append((sorted(channels), depth))
        yield

    def render(self, gaussians, camera, options):
        CALLS.append("render")
        view = reference.BACKEND.render(gaussians, camera, options)
        view.image = 2 * view.image
        return view


BACKEND = Double()
"""


@pytest.fixture
def double(tmp_path, monkeypatch):
    """The module of a backend `double`, which renders images twice as bright as `reference`."""
    (tmp_path / "double.py").write_text(SOURCE)
    monkeypatch.setattr(backends, "__path__", [*backends.__path__, str(tmp_path)])
    load_backend("double")
    yield sys.modules["tdgbench.splats.backends.double"]
    del sys.modules["tdgbench.splats.backends.double"], backends.double


def test_a_new_backend_renders(double):
    assert backend_names() == ["cpu", "cuda", "double", "reference", "warp"] and "double" in fast_backends()
    given, camera = random_gaussians(20, 1, None, 1), turned_camera(16, 12)
    plain = rasterization(*given, *camera, 16, 12, backend="reference")[0]
    image, _, meta = rasterization(*given, *camera, 16, 12, backend="double")
    assert torch.equal(image, 2 * plain) and meta["backend"] == "double" and double.CALLS == ["render"]
    with pytest.raises(ValueError, match="backend double takes float32 tensors, not"):
        rasterization(*(t.double() for t in given), *camera, 16, 12, backend="double")


def test_a_new_backend_trains(double, small_gray_scene):
    compile_kernels({1}, instantiate(config("budget=demo").budget), "double")
    assert [([1], True), *["render"] * 5] == double.CALLS
    trainer = ready_to_train(small_gray_scene, "tdg", 3)
    method = trainer.method
    method.model.backend = method.backend = "double"
    before = method.model.copy()
    train(trainer)
    assert double.CALLS.count("render") == 8
    assert not torch.equal(method.model.gaussians.means, before.means)


def test_every_backend_has_its_yaml():
    files = (ROOT / "conf" / "backend").glob("*.yaml")
    assert {p.stem for p in files} == {"auto", *backend_names()}
    for name in backend_names():
        assert config(f"backend={name}").backend.name == name and Backend in type(load_backend(name)).__mro__


def test_auto_is_the_fast_backend_of_the_device(monkeypatch):
    reasons = {"warp": None, "cuda": None}
    for name, backend in ((name, load_backend(name)) for name in reasons):
        monkeypatch.setattr(type(backend), "why_not", lambda self, name=name: reasons[name])
    cpu, gpu = torch.device("cpu"), torch.device("cuda")
    found = [choose_backend("auto", device, dtype) for device in (cpu, gpu) for dtype in (torch.float32, torch.float64)]
    assert found == ["cpu", "reference", "warp", "reference"]
    reasons["warp"] = "not installed"
    assert choose_backend("auto", gpu, torch.float32) == "cuda"
    reasons["cuda"] = "no compiler"
    with pytest.raises(RuntimeError, match="backend cuda cannot run: no compiler"):
        choose_backend("auto", gpu, torch.float32)
    assert choose_backend("auto", torch.device("meta"), torch.float32) == "reference"


@pytest.mark.parametrize("name", ["gpu", "backend", "", "cpu.Rasterize"])
def test_other_names_are_refused(name):
    with pytest.raises(ValueError, match="it must be one of auto, cpu, cuda, reference, warp"):
        load_backend(name)


def test_an_error_inside_a_backend_is_not_hidden(tmp_path, monkeypatch):
    (tmp_path / "broken.py").write_text("import no_such_module_at_all\n")
    monkeypatch.setattr(backends, "__path__", [*backends.__path__, str(tmp_path)])
    with pytest.raises(ModuleNotFoundError, match="no_such_module_at_all"):
        load_backend("broken")
