"""Marigold (Ke et al. 2024), the paper's estimator: affine-invariant depth by diffusion.

Needs the extra `depth`; downloads its weights from the Hugging Face hub at first use.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from pydantic import NonNegativeInt, PositiveInt

from tdgbench.priors.prior import DepthPrior, chosen_device, importing, loading, model_identity
from tdgbench.scenes import Scene, View
from tdgbench.splats.backends.backend import installed_version

OFFER = "(the paper's network)"


@dataclass
class MarigoldPrior:
    """Prior of kind `depth`: 0 is near, 1 is far. Equal seeds and images give equal maps on one machine.

    model: name on the hub, or a folder. steps: of the diffusion; None means the model's default. ensemble: predictions
    to average. resolution: longest side in px at which the network runs; None means the model's default.
    """

    model: str
    steps: PositiveInt | None
    ensemble: PositiveInt
    resolution: PositiveInt | None
    device: str
    seed: NonNegativeInt

    def identity(self, scene: Scene) -> dict[str, object]:
        options = {name: getattr(self, name) for name in ("steps", "ensemble", "resolution", "seed")}
        variant = {"variant": self._variant} if self._variant else {}
        return {"estimator": "marigold", **self._model, **options, **variant, "version": installed_version("diffusers")}

    def prepare(self) -> None:
        kind = _pipeline_class()
        with loading("marigold", self.model):
            if not Path(self.model).is_dir():
                kind.download(self.model, variant=self._variant)
            elif not (Path(self.model) / "model_index.json").is_file():
                raise FileNotFoundError("the folder has no model_index.json")

    @cached_property
    def _model(self) -> dict[str, object]:
        return model_identity(self.model)

    @cached_property
    def _pipeline(self):
        kind = _pipeline_class()
        with loading("marigold", self.model):
            pipeline = kind.from_pretrained(
                self.model, variant=self._variant, dtype=torch.float32 if self._variant is None else torch.float16
            )
        pipeline.set_progress_bar_config(disable=True)
        return pipeline.to(chosen_device(self.device))

    @property
    def _variant(self) -> str | None:
        return "fp16" if chosen_device(self.device).type == "cuda" else None

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        image = np.broadcast_to(view.thermal, (*view.thermal.shape[:2], 3)).copy()
        seed = int.from_bytes(hashlib.sha256(f"{self.seed}/{view.name}".encode()).digest()[:7], "big")
        generator = torch.Generator(chosen_device(self.device)).manual_seed(seed)
        options = {} if self.resolution is None else {"processing_resolution": self.resolution}
        result = self._pipeline(
            image,
            num_inference_steps=self.steps,
            ensemble_size=self.ensemble,
            match_input_resolution=True,
            generator=generator,
            output_type="np",
            **options,
        )
        return DepthPrior(np.asarray(result.prediction)[0, :, :, 0].astype(np.float32), "depth")


def _pipeline_class():
    with importing("marigold"):
        import transformers  # noqa: F401 (diffusers needs it, and says so late)
        from diffusers import MarigoldDepthPipeline
    return MarigoldDepthPipeline
