import importlib
import sys
import types

import numpy as np
import pytest
import torch

from tdgbench.scoring.backbones import SPECS, make_trunk
from tdgbench.scoring.lpips import LPIPS, Network
from tdgbench.scoring.scored_view import NotApplicableError
from tests.scoring.weights import random_state


def test_documented_values(squeeze_weights):
    """torchmetrics documents 0.1024 and 0.0938 for these inputs."""
    g = torch.Generator().manual_seed(42)
    a = torch.rand(2, 3, 100, 100, generator=g) * 2 - 1
    b = torch.rand(2, 3, 100, 100, generator=g) * 2 - 1
    metric = LPIPS("squeeze", "signed", str(squeeze_weights))
    got = [metric(*((t[i].permute(1, 2, 0).numpy() + 1) / 2 for t in (a, b))) for i in range(2)]
    assert got == pytest.approx([0.1024, 0.0938], abs=1e-3)


def test_conventions_and_gray(squeeze_weights):
    rng = np.random.default_rng(0)
    a, b = rng.random((40, 40, 1)).astype(np.float32), rng.random((40, 40, 1)).astype(np.float32)
    signed, unit = (LPIPS("squeeze", r, str(squeeze_weights)) for r in ("signed", "unit"))
    assert signed(a, b) != pytest.approx(unit(a, b), rel=1e-3)
    assert signed(a, b) == pytest.approx(signed(np.repeat(a, 3, 2), np.repeat(b, 3, 2)))
    assert signed((a + 1) / 2, (b + 1) / 2) == pytest.approx(unit(a, b), abs=1e-6)
    assert signed(a, a) == 0


def fake_torchvision(monkeypatch):
    """A torchvision that has just the three trunks, made of our layers, so that lpips can be imported."""
    module, models = types.ModuleType("torchvision"), types.ModuleType("torchvision.models")

    def build(net):
        return lambda *args, **kwargs: types.SimpleNamespace(features=make_trunk(net))

    models.vgg16, models.alexnet, models.squeezenet1_1 = build("vgg"), build("alex"), build("squeeze")
    module.models = models
    monkeypatch.setitem(sys.modules, "torchvision", module)
    monkeypatch.setitem(sys.modules, "torchvision.models", models)
    for name in [n for n in sys.modules if n == "lpips" or n.startswith("lpips.")]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.parametrize("net", SPECS)
def test_plain_layers_agree_with_the_package(monkeypatch, net):
    fake_torchvision(monkeypatch)
    state = random_state(net)
    lpips = importlib.import_module("lpips")
    package = lpips.LPIPS(net=net, pnet_rand=True, verbose=False)
    for name, parameter in package.net.named_parameters():
        parameter.data.copy_(state[name.split(".", 1)[1]])  # slice2.3.squeeze.weight → 3.squeeze.weight
    plain = Network(net, state)
    g = torch.Generator().manual_seed(1)
    a, b = (torch.rand(1, 3, 64, 72, generator=g) * 2 - 1 for _ in range(2))
    with torch.no_grad():
        assert plain(a, b).item() == pytest.approx(package.eval()(a, b).item(), rel=1e-4)


@pytest.mark.parametrize("net", SPECS)
def test_images_too_small_for_a_network_have_no_lpips(net, monkeypatch):
    monkeypatch.setattr("tdgbench.scoring.lpips.trunk_weights", lambda *of: random_state(net))
    metric, smallest = LPIPS(net, "unit"), SPECS[net].smallest
    image = np.zeros((smallest, smallest + 3, 1), np.float32)
    assert metric(image, image) == 0
    with pytest.raises(NotApplicableError, match=f"{smallest + 3}×{smallest - 1} px .* needs sides of {smallest} px"):
        metric(image[1:], image[1:])
