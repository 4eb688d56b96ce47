"""Two Gaussians, and views that show something else in their footprints."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.scenes import Camera, View
from tdgbench.splats import Gaussians
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole

SIZE = 48


def two() -> Gaussians:
    """Two broad, nearly opaque Gaussians side by side, long in y."""
    return Gaussians(
        means=torch.tensor([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        log_scales=torch.tensor([[0.3, 0.5, 0.05]]).repeat(2, 1).log(),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1), opacity_logits=torch.full((2,), 4.0),
        sh=torch.zeros(2, 1, 1),
    )  # fmt: skip


def view_of(name: str, camera: Camera, image: np.ndarray, valid: np.ndarray | None) -> View:
    load_valid = None if valid is None else lambda: valid
    return View(name, camera, lambda: image, lambda: np.repeat(image, 3, axis=2), load_valid=load_valid)


def views(residual, noise: float = 0.0, count: int = 12, masked=None) -> list[View]:
    """Views from a little beside each other. residual(x, y, number): added to a render of the Gaussians."""
    random = np.random.default_rng(0)
    made = []
    for number in range(count):
        pose = np.eye(4)
        pose[:3, 3] = (0.1 * (number % 4 - 1.5), 0.1 * (number // 4 - 1), 4.0)
        camera = Camera(np.array([[40.0, 0, 24], [0, 40.0, 24], [0, 0, 1]]), pose, SIZE, SIZE)
        y, x = ((np.mgrid[:SIZE, :SIZE] + 0.5 - 24) / 10) - pose[[1, 0], 3][:, None, None]
        image = render_view(two().activated(0), Pinhole.of(camera)).image.numpy()
        image = image + (residual(x, y, number) + random.normal(0, noise, x.shape))[..., None].astype(np.float32)
        valid = None if masked is None else ~masked(x, y)
        made.append(view_of(str(number), camera, image, valid))
    return made


def edge(x, y, number):
    """A step across the first Gaussian, the same in every view."""
    return 0.2 * np.sign(y) * (x < 0)


def drift(x, y, number):
    """Every second view is brighter above, the others below."""
    return 0.2 * np.sign(y) * (-1) ** number
