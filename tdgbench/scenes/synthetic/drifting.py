"""Scenes as a thermal camera with known errors shows them: any scene in °C, with errors added to its images."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace

import numpy as np
from pydantic import NonNegativeInt

from tdgbench.scenes.datasets import Dataset, outline_of
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import is_gray
from tdgbench.scenes.options import Description
from tdgbench.scenes.read import Outline
from tdgbench.scenes.scene import Scene, TemperatureRange, View
from tdgbench.scenes.synthetic.thermal_camera import DegC, ThermalErrors, limits
from tdgbench.scenes.synthetic.thermal_files import levels
from tdgbench.scenes.synthetic.truth import CameraTruth

ROOM = 1.0  # °C between the values and the ends of the range
NOISE = 1  # number of the random stream; those of the camera are others


class DriftingDataset:
    """The scenes of a data set, seen by a thermal camera with errors. The camera is drawn for each scene by the seed.

    dataset: whose images are gray and in °C; they are what an ideal camera would show. errors: of the camera;
    `encoding=agc` stretches each image on its own. noise_degC: standard deviation of what every pixel adds.
    """

    def __init__(
        self, dataset: Dataset, errors: ThermalErrors, noise_degC: DegC = 0.0, seed: NonNegativeInt = 0
    ) -> None:  # fmt: skip
        self.dataset, self.errors, self.noise_degC, self.seed = dataset, errors, noise_degC, seed

    def names(self) -> list[str]:
        return self.dataset.names()

    def missing(self, names: list[str]) -> list[str]:
        return self.dataset.missing(names)

    def explain_missing(self, names: list[str]) -> str:
        return self.dataset.explain_missing(names)

    def describe(self, name: str | int | None) -> Description:
        return self.dataset.describe(name)

    def load(self, name: str | int | None) -> Scene:
        return self.outline(name).read()

    def outline(self, name: str | int | None) -> Outline:
        inner = outline_of(self.dataset, name)

        def read() -> Scene:
            scene, _ = drifting(inner.read(), self.errors, self.seed, self.noise_degC)
            return replace(scene, fingerprint=self._fingerprint(scene))

        return Outline(replace(inner.scene, fingerprint=self._fingerprint(inner.scene)), read)

    def truth(self, name: str | int | None) -> CameraTruth:
        """The true camera of a scene."""
        return drifting(self.dataset.load(name), self.errors, self.seed, self.noise_degC)[1]

    def _fingerprint(self, scene: Scene) -> str:
        added = json.dumps([asdict(self.errors), self.noise_degC, self.seed], sort_keys=True)
        return hashlib.sha256(f"{scene.fingerprint} {added}".encode()).hexdigest()[: len(scene.fingerprint)]


def drifting(clean: Scene, errors: ThermalErrors, seed: int, noise_degC: float = 0.0) -> tuple[Scene, CameraTruth]:
    """The scene as a camera with the given errors shows it, and that camera.

    The range grows, so that nothing is clipped; with gain control, there is none. The given scene's temperatures become
    the true ones, unless it has truer ones. Raises SceneError for a scene that is not gray and in °C.
    """
    colored = [view.name for view in clean.views if not is_gray(view.thermal)]
    if clean.temperature is None or colored:
        why = "pseudo-colour" if colored else "no temperature range; set data.temperature=[MIN,MAX]"
        raise SceneError(f"{clean.name} has {why}: errors in °C can be added to gray images of temperatures alone")
    views = clean.views
    sizes = {(view.camera.width, view.camera.height) for view in views}
    if len(sizes) > 1:
        raise SceneError(f"{clean.name} has images of several sizes: a camera has one vignette; set data.width")
    given = (clean.temperature.min, clean.temperature.max)
    camera = errors.drawn(sizes.pop(), given, np.zeros(len(views)), [seed])
    rng = np.random.default_rng([seed, NOISE])
    shown = {}
    for index, view in enumerate(views):
        degC = _degC(view, clean)
        shown[view.name] = camera.shown(degC, index, rng.normal(0, noise_degC, degC.shape))
    span: TemperatureRange | None = None
    if errors.files == "agc":
        ends = [limits(one) for one in shown.values()]
        images = {name: levels(one, *pair) / 255 for (name, one), pair in zip(shown.items(), ends, strict=True)}
        camera = replace(camera, limits=np.array(ends))
    else:
        low, high = (float(end(list(map(end, shown.values())))) for end in (np.min, np.max))
        span = TemperatureRange(low - ROOM, high + ROOM)
        images = {name: (one - low + ROOM) / (high - low + 2 * ROOM) for name, one in shown.items()}

    def seen(view: View) -> View:
        image = np.repeat(images[view.name].astype(np.float32)[..., None], clean.channels, axis=2)
        truth = view.load_true_temperature or (lambda: _degC(view, clean).astype(np.float32))
        return replace(view, load_thermal=lambda: image, load_true_temperature=truth)

    scene = replace(
        clean, train=[seen(view) for view in clean.train], test=[seen(view) for view in clean.test], temperature=span
    )  # fmt: skip
    return scene, CameraTruth([view.name for view in views], camera)


def _degC(view: View, scene: Scene) -> np.ndarray:
    """Temperatures (H, W) of a view, °C."""
    assert scene.temperature is not None
    low, high = scene.temperature.min, scene.temperature.max
    return low + (high - low) * view.thermal.mean(axis=2, dtype=np.float64)
