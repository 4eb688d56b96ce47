"""LPIPS v0.1 (Zhang et al. 2018), with the linear heads of the `lpips` package.

The package itself needs torchvision, which fails beside a CPU build of torch. The network here agrees with the
package's to float rounding (tested).
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from tdgbench.files import opened
from tdgbench.scoring.backbones import SPECS, BackboneUnavailableError, Net, make_trunk, trunk_weights
from tdgbench.scoring.scored_view import NotApplicableError

Range = Literal["unit", "signed"]
ROWS = 64  # of features that are compared at once
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class LPIPS:
    """Perceptual distance of two images.

    input_range `signed`: images are mapped to [−1, 1] as LPIPS expects; `unit`: they stay in [0, 1] as in 3DGS's
    metrics.py (a quirk of published tables). The network runs on the CPU, wherever the cell trained: a GPU would round
    convolutions to TF32. Raises BackboneUnavailableError if no weights are available.
    """

    def __init__(self, net: Net, input_range: Range, weights: str | None = None, download: bool = True) -> None:
        if net not in SPECS:
            raise ValueError(f"metrics.lpips.net is {net!r}; it must be one of {', '.join(SPECS)}")
        self.net, self.input_range = net, input_range
        self.model = Network(net, trunk_weights(net, weights, download)).eval().requires_grad_(False)

    @torch.no_grad()
    def __call__(self, image: np.ndarray, target: np.ndarray) -> float:
        """Return the distance of images (H, W, 1 or 3) in [0, 1]; gray images become three equal channels.

        Raises NotApplicableError for images that are too small for the network.
        """
        height, width = image.shape[:2]
        if min(height, width) < self.model.spec.smallest:
            needed = f"{self.net} needs sides of {self.model.spec.smallest} px"
            raise NotApplicableError(f"images of {width}×{height} px are too small for LPIPS: {needed}")
        return float(self.model(self._prepare(image), self._prepare(target)))

    def _prepare(self, image: np.ndarray) -> Tensor:
        tensor = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None]
        tensor = tensor.expand(1, 3, *tensor.shape[2:])
        return tensor * 2 - 1 if self.input_range == "signed" else tensor


class Network(nn.Module):
    """LPIPS of images: differences of unit-length features, weighted by the heads, averaged over the image."""

    shift: Tensor
    scale: Tensor

    def __init__(self, net: Net, state: dict[str, Tensor]) -> None:
        super().__init__()
        self.spec = SPECS[net]
        self.trunk = make_trunk(net)
        self.trunk.load_state_dict(state)
        self.heads = nn.ParameterList(_heads(net))
        self.register_buffer("shift", torch.tensor(SHIFT).view(1, 3, 1, 1))
        self.register_buffer("scale", torch.tensor(SCALE).view(1, 3, 1, 1))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Return the distances (N,) of images (N, 3, H, W).

        Both images pass a layer before either passes the next one, so that no features but the layer's are in memory.
        """
        x, y = ((image - self.shift) / self.scale for image in (a, b))
        distance, heads = torch.zeros(len(a)), iter(self.heads)
        for count, layer in enumerate(self.trunk, start=1):
            x = layer(x)
            y = layer(y)
            if count in self.spec.ends:
                distance = distance + _weighted(x, y, next(heads)).mean(dim=(1, 2)).cpu()
            if count == self.spec.ends[-1]:
                break
        return distance


def _weighted(x: Tensor, y: Tensor, head: Tensor) -> Tensor:
    """Return the squared differences (N, H, W) of unit-length features (N, C, H, W), weighted by a head (1, C, 1, 1).

    Rows are taken some at a time: the result is the same, the memory is that of a few rows.
    """
    rows = zip(x.split(ROWS, dim=2), y.split(ROWS, dim=2), strict=True)
    return torch.cat([((_unit(a) - _unit(b)) ** 2 * head).sum(dim=1) for a, b in rows], dim=1)


def _unit(x: Tensor) -> Tensor:
    return x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)


def _heads(net: Net) -> list[Tensor]:
    """Return the linear heads (1, C, 1, 1) from the files of the lpips package, without importing it."""
    package = importlib.util.find_spec("lpips")
    if package is None or not package.submodule_search_locations:
        raise BackboneUnavailableError("the lpips package, which holds the linear heads, is not installed")
    path = Path(package.submodule_search_locations[0]) / "weights" / "v0.1" / f"{net}.pth"
    with opened(path) as file:
        state = torch.load(file, map_location="cpu", weights_only=True)
    return [state[f"lin{i}.model.1.weight"] for i in range(len(SPECS[net].ends))]
