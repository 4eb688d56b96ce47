"""A model and a view that stand for one image each: what a method's loss is computed from, without a renderer."""

from __future__ import annotations

from types import SimpleNamespace

import torch

from tdgbench.scenes import Camera, View
from tdgbench.splats.view import Render
from tests.parity.originals import original

IMAGES = {"rgb": "color", "thermal": "flat"}  # of the losses' fixture


def image_of(modality: str, part: str) -> torch.Tensor:
    """(H, W, 3): `image` is the render, `target` what it should be."""
    return torch.from_numpy(original("losses")[f"{IMAGES[modality]}_{part}"]).permute(1, 2, 0).contiguous()


class Still:
    """A model of so many Gaussians that always renders the same image."""

    def __init__(self, modality: str, gaussians: int) -> None:
        self.image = image_of(modality, "image").requires_grad_()
        self.gaussians = gaussians

    def __len__(self) -> int:
        return self.gaussians

    def render(self, camera: Camera, *, depth: bool = False) -> Render:
        assert not depth
        return Render(self.image, None, torch.zeros(self.image.shape[:2]))


def standing_view() -> SimpleNamespace:
    """A view order with a single view."""
    images = {name: image_of(name, "target").numpy() for name in IMAGES}
    view = View(
        "view", Camera(torch.eye(3).numpy(), torch.eye(4).numpy(), 31, 24),
        load_thermal=lambda: images["thermal"], load_rgb=lambda: images["rgb"],
    )  # fmt: skip
    return SimpleNamespace(next=lambda: view, has_ended=False)
