"""Depth Anything V2 (Yang et al. 2024): affine-invariant inverse depth by one pass of a network.

Needs the extra `depth`; downloads its weights from the Hugging Face hub at first use.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from tdgbench.priors.prior import DepthPrior, chosen_device, importing, loading, model_identity
from tdgbench.scenes import Scene, View
from tdgbench.splats.backends.backend import installed_version

OFFER = "(another network, also from thermal images alone)"


@dataclass
class DepthAnythingPrior:
    """Prior of kind `disparity`: larger is nearer. It has no seed: equal images give equal maps on one machine.

    model: name on the hub, or a folder; any model of transformers' AutoModelForDepthEstimation that gives a disparity.
    The model's own processor resizes and normalises the image, as 8-bit colours.
    """

    model: str
    device: str

    def prepare(self) -> None:
        _ = self._network

    def identity(self, scene: Scene) -> dict[str, object]:
        return {"estimator": "depth_anything", **self._model, "version": installed_version("transformers")}

    @torch.no_grad()
    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        processor, network = self._network
        height, width = view.thermal.shape[:2]
        image = np.broadcast_to(np.clip(view.thermal * 255 + 0.5, 0, 255).astype(np.uint8), (height, width, 3))
        inputs = processor(images=np.ascontiguousarray(image), return_tensors="pt").to(network.device)
        (estimate,) = processor.post_process_depth_estimation(network(**inputs), target_sizes=[(height, width)])
        return DepthPrior(estimate["predicted_depth"].float().cpu().numpy(), "disparity")

    @cached_property
    def _model(self) -> dict[str, object]:
        return model_identity(self.model)

    @cached_property
    def _network(self) -> tuple[Any, Any]:
        """The image processor and the network."""
        with importing("depth_anything"):
            from transformers import AutoImageProcessor, AutoModelForDepthEstimation
        with loading("depth_anything", self.model):
            # Pillow instead of torchvision, which the extra does not need, and which differs in its resizing.
            processor = AutoImageProcessor.from_pretrained(self.model, backend="pil")
            network = AutoModelForDepthEstimation.from_pretrained(self.model, dtype=torch.float32)
        return processor, network.eval().to(chosen_device(self.device))
