"""A trained model of another program: 3DGS's PLY files, which our core renders. Nothing is trained."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from methods.likeness import LEAST, WIDTH, details
from tdgbench.scenes import Scene, SceneError
from tdgbench.scenes.inputs import hash_of, regular_file
from tdgbench.splats import Gaussians
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.images import MODALITIES
from tdgbench.training.method import Frame, Method
from tdgbench.training.splat_model import SplatModel

THERMAL_DC, THERMAL_REST = "t_dc", "t_rest"  # Thermal-Gaussian-main, OMMG, scene/gaussian_model.py, line 208
VIEWS = 12  # training views that are compared
TIE = 0.02  # lead of another image that is no lead
# Of the views. It is 1 for 10 models at 24 to 39 dB; of 198 that were moved, 23 have more, which were turned by 10° or
# scaled or moved by less than a third.
LEAST_SHARE = 0.8


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
        self.models: dict[str, SplatModel] = {}
        self.notes: list[str] = []
        for modality, gaussians in self._gaussians().items():
            gaussians = self._about_origin(gaussians, context.scene, modality)
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

    def _about_origin(self, gaussians: Gaussians, scene: Scene, modality: str) -> Gaussians:
        """Return a model about the scene's origin, if that is not its files' and the model lies nearer to theirs."""
        origin = torch.tensor(scene.origin, dtype=torch.float64)
        means = gaussians.means.double()
        middle = means.median(dim=0).values
        if (middle - origin).norm() >= middle.norm():
            return gaussians
        self.notes.append(f"the {modality} model is moved with the scene, whose origin is now {scene.origin}")
        return replace(gaussians, means=(means - origin).float())

    def doubts(self, scene: Scene) -> list[str]:
        """Doubt a model whose renders are more like other views than like their own: it may be of another world."""
        return [doubt for modality in self.models for doubt in self._doubts_of(modality, scene)]

    def _doubts_of(self, modality: str, scene: Scene) -> Iterator[str]:
        images = MODALITIES[modality]
        views = [view for view in scene.train if modality == "thermal" or view.load_rgb is not None]
        if len(views) < 3:
            return
        views = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, VIEWS).round().astype(int))]
        masks = [images.valid(view) for view in views]
        height = max(1, round(WIDTH * views[0].camera.height / views[0].camera.width))
        frames = (Frame(view.camera.resized(WIDTH, height)) for view in views)
        rendered = details((self.render(frame, modality).image.cpu().numpy() for frame in frames), masks)
        share = own_share(rendered, details((images.array(view) for view in views), masks))
        if share < LEAST_SHARE:
            yield (
                f"{self.paths.get(modality, self.paths['thermal']).name} does not lie where the cameras look: of "
                f"{len(views)} {modality} renders of training views, {share * len(views):.0f} look more like their own "
                "image than like that of another view; is the model in the scene's world, and is it of this scene?"
            )

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


def own_share(rendered: np.ndarray, shown: np.ndarray) -> float:
    """Return the share of renders (N, P) that correlate with their own image, and with no other of the (N, P) more.

    Each row has the mean 0 and the norm 1, so that contrast and brightness do not count.

    >>> images = np.eye(4)
    >>> own_share(images, images), own_share(images[[0, 2, 1, 3]], images), own_share(0 * images, images)
    (1.0, 0.5, 0.0)
    """
    alike = rendered @ shown.T
    own = alike.diagonal()
    return float(np.mean((own > LEAST) & (own >= alike.max(axis=1) - TIE)))


def _read(path: Path) -> Gaussians:
    try:
        gaussians = load_ply(regular_file(path))
    except ValueError as error:
        raise SceneError(str(error)) from error
    if not len(gaussians):
        raise SceneError(f"{path} has no Gaussian")
    return gaussians
