"""Thermal3D-GS's networks and corner loss, in value and gradient, against the authors' code."""

import torch

from methods.thermal3dgs import Conduction, Transmission, corner_loss
from tests.parity.originals import original, relative

HEADS = {"abs": "absorption", "d": "distance", "sca": "scattering"}
KINDS = ("linear", *HEADS)
CLOSE = 1e-5


def of_transmission(name: str) -> str:
    """Return our name of a parameter of the original's network."""
    kind, *rest = name.split("__")
    return ".".join(["layers" if kind == "linear" else HEADS[kind], *rest])


def image(array):
    """Return an image (H, W, C) of the original's (C, H, W)."""
    return torch.from_numpy(array).permute(1, 2, 0).contiguous().requires_grad_()


def test_transmission():
    data = original("thermal3dgs")
    network = Transmission(width=16)
    names = [name for name, _ in network.named_parameters()]
    gradients = {of_transmission(k[9:]): v for k, v in data.items() if k.startswith("atf_grad_")}
    assert sorted(gradients) == sorted(names)
    weights = {k[4:]: v for k, v in data.items() if k.startswith("atf_") and k[4:].split("__")[0] in KINDS}
    given = {of_transmission(name): values for name, values in weights.items()}
    network.load_state_dict({name: torch.from_numpy(values) for name, values in given.items()})
    factor = network(torch.from_numpy(data["atf_x"]), float(data["atf_time"]))
    assert relative(factor.detach(), data["atf_factor"]) < CLOSE
    (factor * torch.from_numpy(data["atf_weights"])).sum().backward()
    for name, parameter in network.named_parameters():
        assert relative(parameter.grad, gradients[name]) < CLOSE, name


def test_conduction():
    data = original("thermal3dgs")
    torch.manual_seed(int(data["tcm_seed"]))
    module = Conduction()
    given = image(data["tcm_image"])
    added = module(given)
    theirs = torch.from_numpy(data["tcm_out"])
    assert relative(added[..., 0].detach(), theirs[0]) < CLOSE
    weights = torch.linspace(0, 1, theirs.numel()).reshape(theirs.shape).sin().permute(1, 2, 0)
    (added * weights).sum().backward()
    assert relative(given.grad.permute(2, 0, 1), data["tcm_grad_image"]) < CLOSE
    for layer, name in zip(module.layers, ("TCM", "TCM1", "TCM2"), strict=True):
        assert relative(layer.weight.grad, data[f"tcm_grad_{name}__conv__weight"]) < CLOSE
        assert relative(layer.bias.grad, data[f"tcm_grad_{name}__conv__bias"]) < CLOSE


def test_as_many_seeds_leave_the_conduction_module_dead():
    data = original("thermal3dgs")
    given, dead = image(data["tcm_dead_image"]), 0
    for seed in range(200):
        torch.manual_seed(seed)
        dead += float(Conduction()(given).detach().max()) == 0
    assert dead == int(data["tcm_dead"])


def test_corner_loss():
    data = original("thermal3dgs")
    given, target = image(data["corner_image"]), image(data["corner_target"]).detach()
    loss = corner_loss(given, target)
    assert relative([loss.item()], [data["corner_loss"]]) < CLOSE
    loss.backward()
    assert relative(given.grad.permute(2, 0, 1), data["corner_grad"]) < CLOSE
