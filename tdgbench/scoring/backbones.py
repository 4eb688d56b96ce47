"""Convolutional trunks of LPIPS in plain torch layers, with torchvision's state-dict names, and their weights."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from filelock import FileLock
from torch import Tensor, nn

from tdgbench.files import opened, sha256_of
from tdgbench.scoring.scored_view import NotApplicableError

Net = Literal["vgg", "alex", "squeeze"]
DOWNLOAD_TIMEOUT_SECONDS = 20
NAME_IT = "metrics.lpips.weights=FILE (verify and tables sensitivity: --weights)"
_failed_downloads: dict[str, str] = {}


class BackboneUnavailableError(NotApplicableError):
    """No weights for the trunk."""


@dataclass(frozen=True)
class TrunkSpec:
    """A trunk's weights, and the layers whose features LPIPS compares."""

    file: str  # in torch's cache and hub
    ends: tuple[int, ...]  # numbers of layers before each set of features
    smallest: int  # px; shorter sides leave no feature at the end


HUB = "https://download.pytorch.org/models/"
SPECS: dict[Net, TrunkSpec] = {
    "vgg": TrunkSpec("vgg16-397923af.pth", (4, 9, 16, 23, 30), 16),
    "alex": TrunkSpec("alexnet-owt-7be5be79.pth", (2, 5, 8, 10, 12), 31),
    "squeeze": TrunkSpec("squeezenet1_1-b8a52dc0.pth", (2, 5, 8, 10, 11, 12, 13), 17),
}


class Fire(nn.Module):
    """SqueezeNet's block: squeeze, then expand with 1×1 and 3×3 kernels in parallel."""

    def __init__(self, inputs: int, squeeze: int, expand: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(inputs, squeeze, 1)
        self.expand1x1 = nn.Conv2d(squeeze, expand, 1)
        self.expand3x3 = nn.Conv2d(squeeze, expand, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        x = self.squeeze(x).relu_()
        return torch.cat([self.expand1x1(x).relu_(), self.expand3x3(x).relu_()], dim=1)


def make_trunk(net: Net) -> nn.Sequential:
    """Return the `features` of torchvision's vgg16, alexnet or squeezenet1_1, without weights."""
    if net == "vgg":
        layers: list[nn.Module] = []
        inputs = 3
        for width, count in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
            for _ in range(count):
                layers += [nn.Conv2d(inputs, width, 3, padding=1), nn.ReLU(True)]
                inputs = width
            layers.append(nn.MaxPool2d(2, 2))
        return nn.Sequential(*layers)
    if net == "alex":
        return nn.Sequential(
            nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(True), nn.MaxPool2d(3, 2),
            nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(True), nn.MaxPool2d(3, 2),
            nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(True),
            nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(True),
            nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(True), nn.MaxPool2d(3, 2),
        )  # fmt: skip
    return nn.Sequential(
        nn.Conv2d(3, 64, 3, stride=2), nn.ReLU(True), nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(64, 16, 64), Fire(128, 16, 64), nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(128, 32, 128), Fire(256, 32, 128), nn.MaxPool2d(3, 2, ceil_mode=True),
        Fire(256, 48, 192), Fire(384, 48, 192), Fire(384, 64, 256), Fire(512, 64, 256),
    )  # fmt: skip


def trunk_weights(net: Net, file: str | None, download: bool) -> dict[str, Tensor]:
    """Return the trunk's state dict (`features.*` of torchvision's names, prefix removed).

    From `file` (pth or npz), else torch's cache, else downloaded into it. Raises BackboneUnavailableError with the
    reason. A failed download is not tried again in the same process.
    """
    spec = SPECS[net]
    cached = Path(torch.hub.get_dir()) / "checkpoints" / spec.file
    if file is not None:
        state = _read(Path(file))
    elif cached.exists():
        if own_weights(net, str(cached)):
            what = "is not torchvision's file, whose SHA-256 its name states"
            raise BackboneUnavailableError(f"{cached} {what}: delete it, or name a file of yours: {NAME_IT}")
        state = _read(cached)
    elif download:
        state = _download(net, spec, cached)
    else:
        raise BackboneUnavailableError(
            f"no {net} backbone: {spec.file} is not in torch's cache and metrics.lpips.download is false; set it true, "
            f"or name the file: {NAME_IT}; cells that are there get their LPIPS by tdgbench score DIR OUT"
        )
    features = {k.removeprefix("features."): v for k, v in state.items() if k.startswith("features.")}
    expected = make_trunk(net).state_dict()
    wrong = [k for k, v in expected.items() if k not in features or features[k].shape != v.shape]
    if wrong:
        raise BackboneUnavailableError(f"{file or cached} does not hold the {net} backbone (features.{wrong[0]})")
    return {k: features[k].float() for k in expected}


def own_weights(net: Net, file: str | None) -> str:
    """Return SHA-256 of a file of one's own; empty for torchvision's, whose name states its hash, and for none."""
    if file is None or not Path(file).is_file():  # without it there are no scores
        return ""
    found = _sha256(Path(file), Path(file).stat().st_mtime_ns)
    return "" if net in SPECS and found.startswith(Path(SPECS[net].file).stem.rpartition("-")[2]) else found


@cache
def _sha256(path: Path, changed: int) -> str:
    """Return SHA-256 of a file that was changed at this time: half a gigabyte, once for all cells."""
    return sha256_of(path)


def _read(path: Path) -> dict[str, Tensor]:
    """Read a file that the user or torch's cache names; torchvision's are of a format that `load_tensors` refuses."""
    try:
        with opened(path) as file:
            if path.suffix == ".npz":
                with np.load(file, allow_pickle=False) as stored:
                    return {k: torch.from_numpy(stored[k].astype(np.float32)) for k in stored.files}
            return torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:
        raise BackboneUnavailableError(f"{path} cannot be read as backbone weights: {error}") from error


def _download(net: Net, spec: TrunkSpec, cached: Path) -> dict[str, Tensor]:
    """Download into torch's cache; of processes that ask at the same time, one does, and the others wait for it."""
    if net in _failed_downloads:
        raise BackboneUnavailableError(_failed_downloads[net])
    timeout = socket.getdefaulttimeout()
    socket.setdefaulttimeout(DOWNLOAD_TIMEOUT_SECONDS)
    try:
        cached.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(cached.with_suffix(".lock")):
            return torch.hub.load_state_dict_from_url(
                HUB + spec.file, map_location="cpu", progress=False, check_hash=True, weights_only=True
            )
    except Exception as error:
        _failed_downloads[net] = (
            f"backbone {spec.file} could not be downloaded ({error}); put it into torch's cache or set "
            "metrics.lpips.weights=FILE"
        )
        raise BackboneUnavailableError(_failed_downloads[net]) from error
    finally:
        socket.setdefaulttimeout(timeout)
