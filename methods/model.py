"""A trained model of another program: 3DGS's PLY files, which our core renders. Nothing is trained."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import torch

from tdgbench.scenes import Scene, SceneError
from tdgbench.scenes.inputs import hash_of, regular_file
from tdgbench.splats import Gaussians
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import MODALITIES
from tdgbench.training.method import Frame, Method

THERMAL_DC, THERMAL_REST = (
    "t_dc",
    "t_rest",
)  # chen-hangyu/Thermal-Gaussian-main, OMMG, scene/gaussian_model.py, line 208


class Model(Method):
    """Gaussians at the SH degree of their file, over the budget's background: black, as all 3DGS programs have it."""

    trains = False

    def __init__(self, ply: str, rgb: str | None, fields: Literal["3dgs", "ommg"]) -> None:
        """ply, rgb: files of the thermal and the RGB model. fields: `ommg` has both in `ply`."""
        if rgb is not None and fields == "ommg":
            raise ValueError("method.rgb: a file with fields=ommg holds the RGB model as well; leave it out")
        self.paths = {"thermal": Path(ply), **({} if rgb is None else {"rgb": Path(rgb)})}
        self.fields = fields
        self.modalities = ("thermal", "rgb") if rgb is not None or fields == "ommg" else ("thermal",)

    def made_elsewhere(self, scene: Scene) -> dict[str, Any]:
        digest = hashlib.sha256(b"".join(hash_of(path) for path in self.paths.values()))
        return {"files": digest.hexdigest()[:16], "summary": "made elsewhere, in a time that is not known"}

    def setup(self, context: Context) -> None:
        self.models = {}
        for modality, gaussians in self._gaussians().items():
            channels = MODALITIES[modality].channels(context.scene)
            if gaussians.channels < channels:
                gaussians = replace(gaussians, sh=gaussians.sh.expand(-1, -1, channels).contiguous())
            if gaussians.channels > channels:
                raise SceneError(
                    f"{self.paths['thermal']} has coloured Gaussians, the thermal images of {context.scene.name} are "
                    "gray; data.channels=3 compares them in three channels"
                )
            self.models[modality] = context.gaussians(modality, start=gaussians)
            self.models[modality].degree = gaussians.sh_degree

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        return self.models[modality].render(frame.camera, depth=modality == "thermal")

    def _gaussians(self) -> dict[str, Gaussians]:
        """Read the models by modality. Raises SceneError for other fields than those that are said to be there."""
        files = {modality: _read(path) for modality, path in self.paths.items()}
        for modality, gaussians in files.items():
            if (THERMAL_DC in gaussians.extra_fields) != (self.fields == "ommg"):
                has = "no" if self.fields == "ommg" else "thermal colours in"
                other = "3dgs" if self.fields == "ommg" else "ommg"
                raise SceneError(
                    f"{self.paths[modality]} has {has} {THERMAL_DC}_* fields; is it method.fields={other}?"
                )
        plain = {modality: replace(gaussians, extra_fields={}) for modality, gaussians in files.items()}
        if self.fields == "3dgs":
            return plain
        return {"thermal": replace(plain["thermal"], sh=self._thermal_sh(files["thermal"])), "rgb": plain["thermal"]}

    def _thermal_sh(self, gaussians: Gaussians) -> torch.Tensor:
        """Return the thermal harmonics (N, K, C) of an OMMG file, whose rest is stored channel by channel."""
        rest = gaussians.extra_fields.get(THERMAL_REST, torch.zeros(len(gaussians), 0))
        dc = gaussians.extra_fields[THERMAL_DC]
        if dc.shape[1:] != (3,) or rest.shape[1:] != (3 * (gaussians.sh.shape[1] - 1),):
            raise SceneError(
                f"{self.paths['thermal']} has other numbers of {THERMAL_DC}_*, {THERMAL_REST}_* than of f_*"
            )
        sh = torch.cat([dc[:, None], rest.reshape(len(dc), 3, -1).transpose(1, 2)], dim=1)
        return sh[..., :1].contiguous() if bool((sh == sh[..., :1]).all()) else sh.contiguous()


def _read(path: Path) -> Gaussians:
    try:
        gaussians = load_ply(regular_file(path))
    except ValueError as error:
        raise SceneError(str(error)) from error
    if not len(gaussians):
        raise SceneError(f"{path} has no Gaussian")
    return gaussians
