"""Veta-GS's networks, loss, deformation and time noise, in value and gradient, against the authors' code."""

import numpy as np
import pytest
import torch

from methods.veta_gs import (
    Deformation,
    MonoSSIM,
    VetaGS,
    center_of,
    deformed,
    direction_of,
)
from tdgbench.splats import Gaussians
from tdgbench.splats.geometry import rotation_matrices
from tdgbench.splats.view import Pinhole
from tests.parity.originals import original, relative

CLOSE = 1e-5
HEADS = {"gaussian_warp": "means", "gaussian_rotation": "quats", "gaussian_scaling": "scales"}
NETWORKS = {"FFM": "spectra", "IFM": "images", "EFM": "edges"}
LAYERS = {"layer1": "0", "layer2": "2"}
CHANGES = ("means", "quats", "scales")


@pytest.fixture(scope="module")
def data():
    return original("veta_gs")


def tensor(array):
    return torch.from_numpy(np.asarray(array, np.float64))


def of_deformation(name: str) -> str:
    """Return our name of a parameter of the original's network."""
    kind, *rest = name.split("__")
    return ".".join([HEADS.get(kind, "layers"), *rest])


def of_features(name: str) -> str:
    network, layer, kind = name.split("_", 1)[0], *name.split("_", 1)[1].split("__conv__")
    return f"{NETWORKS[network]}.{LAYERS[layer]}.{kind}"


def test_deformation_network(data):
    network = Deformation(width=16).double()
    theirs = {of_deformation(k[4:]): tensor(v) for k, v in data.items() if k.startswith(("net_linear", "net_gaussian"))}
    gradients = {of_deformation(k[9:]): v for k, v in data.items() if k.startswith("net_grad_")}
    assert sorted(gradients) == sorted(theirs) == sorted(name for name, _ in network.named_parameters())
    network.load_state_dict({**theirs, "applied": torch.tensor(True)})
    view = tensor(data["net_in_center"]), tensor(data["net_in_direction"])
    changes = network(tensor(data["net_in_x"]), float(data["net_in_time"]), *view)
    for name, change in zip(CHANGES, changes, strict=True):
        assert relative(change.detach(), data[f"net_out_{name}"]) < CLOSE, name
    sum(
        (change * tensor(data[f"net_w_{name}"])).sum() for name, change in zip(CHANGES, changes, strict=True)
    ).backward()
    for name, parameter in network.named_parameters():
        assert relative(parameter.grad, gradients[name]) < CLOSE, name


def mono_ssim(data):
    """Return the loss with the original's weights, and the pair of images (H, W, 3)."""
    loss = MonoSSIM().double()
    weights = {of_features(k[5:]): tensor(v) for k, v in data.items() if k[5:9] in ("FFM_", "IFM_", "EFM_")}
    loss.load_state_dict(weights)
    image, target = (tensor(data[f"mono_{name}"]).permute(1, 2, 0) for name in ("image", "target"))
    return loss, image.requires_grad_(), target


def test_mono_ssim(data):
    loss, image, target = mono_ssim(data)
    value = loss(image, target)
    assert value.item() == pytest.approx(float(data["mono_loss"]), rel=CLOSE)
    value.backward()
    assert relative(image.grad.permute(2, 0, 1), data["mono_grad_image"]) < CLOSE
    gradients = {of_features(k[10:]): v for k, v in data.items() if k.startswith("mono_grad_") and "conv" in k}
    assert sorted(gradients) == sorted(name for name, _ in loss.named_parameters())
    for name, parameter in loss.named_parameters():
        assert relative(parameter.grad, gradients[name]) < CLOSE, name


def loop_state(data):
    """Return Gaussians, the changes of visible ones in the last iteration, and cameras of those after the warm-up."""
    sh = torch.cat([tensor(data["loop_dc"]), tensor(data["loop_rest"])], dim=1)
    fields = {name: tensor(data[f"loop_{name}"]) for name in ("means", "log_scales", "quats")}
    opacities = tensor(data["loop_opacity"])[:, 0]
    gaussians = Gaussians(**fields, opacity_logits=opacities, sh=sh).map(lambda t: t.requires_grad_())
    changes = [tensor(data[f"loop_7_delta_{name}"]).requires_grad_() for name in CHANGES]
    views = {iteration: int(data[f"loop_{iteration}_view"]) for iteration in range(3, 8)}
    viewmats = {iteration: tensor(data["loop_viewmats"][view]) for iteration, view in views.items()}
    cameras = {iteration: Pinhole(viewmat, torch.eye(3).double(), 22, 18) for iteration, viewmat in viewmats.items()}
    return gaussians, changes, cameras


def test_what_the_network_is_given(data):
    """Centre and direction of the camera, and the time: that of the view plus noise, by views left and iteration."""
    _, _, cameras = loop_state(data)
    method = VetaGS(0.2, 0.2, 0.5, 3 / 40000, 0.1, 0.5, [8e-4, 1.6e-6], [1.6e-5, 1.6e-6], 5.0)
    method.iterations = 40000
    for iteration, camera in cameras.items():
        given = {name: data[f"loop_{iteration}_{name}"] for name in ("center", "direction", "time", "draw", "stack")}
        assert relative(center_of(camera), given["center"]) < CLOSE
        assert relative(direction_of(camera), given["direction"]) < CLOSE
        time = int(data[f"loop_{iteration}_view"]) / 3
        noise = float(given["draw"]) * method.noise_at(iteration, int(given["stack"]))
        assert noise > 0.005 and time + noise == pytest.approx(float(given["time"]), rel=CLOSE)


def test_what_is_rendered(data):
    """Deformed means and covariances, and undeformed colours, in value and gradient; quaternions keep their length."""
    gaussians, changes, cameras = loop_state(data)
    visible = torch.from_numpy(data["loop_seen"][int(data["loop_7_view"])]).nonzero().squeeze(1)
    tensors = deformed(gaussians, 3, cameras[7], visible, changes)
    axes = rotation_matrices(tensors.quats) * tensors.scales[:, None]
    ours = {"means3D": tensors.means, "colors_precomp": tensors.colors, "covariances": axes @ axes.mT}
    theirs = {name: data["loop_covariances" if name == "covariances" else f"loop_given_{name}"] for name in ours}
    lengths = np.linalg.norm(data["loop_given_rotations"], axis=1)
    assert lengths.max() > 1.05 and (data["loop_given_scales"] < 0).any()
    for name, values in ours.items():
        assert relative(values.detach(), theirs[name]) < CLOSE, name
    sum((values * tensor(data[f"loop_w_{name}"])).sum() for name, values in ours.items()).backward()
    for name, change in zip(CHANGES, changes, strict=True):
        assert relative(change.grad, data[f"loop_grad_delta_{name}"]) < CLOSE, name
    for name in ("means", "log_scales", "quats"):
        assert relative(getattr(gaussians, name).grad, data[f"loop_grad_{name}"]) < CLOSE, name
    assert relative(gaussians.sh.grad[:, :1], data["loop_grad_dc"]) < CLOSE
    assert relative(gaussians.sh.grad[:, 1:], data["loop_grad_rest"]) < CLOSE
