"""Scenes as a thermal camera with known errors shows them: any scene in °C, with errors added to its images."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace

import numpy as np
from pydantic import NonNegativeInt

from tdgbench.scenes.datasets import Dataset, Outlines, outline_of
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.scenes.options import Description
from tdgbench.scenes.read import Outline
from tdgbench.scenes.registry import DRIFTING
from tdgbench.scenes.scene import Scene, TemperatureRange, View
from tdgbench.scenes.synthetic.capture import CameraTruth, DegC, ThermalErrors, levels, limits

ROOM = 1.0  # °C between the values and the ends of the range
NOISE = 9  # number of the random stream; those of the camera are others


@dataclass(frozen=True, eq=False)
class DriftingDataset(Outlines):
    """The scenes of a data set, seen by a thermal camera with errors, which the seed draws for each scene."""

    inner: Dataset  # whose images are gray and in °C; they are what an ideal camera would show
    errors: ThermalErrors
    noise_degC: DegC = 0.0  # standard deviation of what every pixel adds
    seed: NonNegativeInt = 0

    def names(self) -> list[str]:
        return self.inner.names()

    def missing(self, names: list[str]) -> list[str]:
        return self.inner.missing(names)

    def explain_missing(self, names: list[str]) -> str:
        return self.inner.explain_missing(names)

    def describe(self, name: str | None) -> Description:
        description = self.inner.describe(name)
        return replace(description, dataset=description.dataset + DRIFTING, group="")

    def outline(self, name: str | None) -> Outline:
        inner, title = outline_of(self.inner, name), self.describe(name).dataset
        added = json.dumps([asdict(self.errors), self.noise_degC, self.seed], sort_keys=True).encode()

        def titled(scene: Scene) -> Scene:
            return replace(scene, dataset=title, fingerprint=scene.fingerprint_with(added))

        return Outline(titled(inner.scene), lambda: titled(self._drifting(inner.read())[0]))

    def truth(self, name: str | None) -> CameraTruth:
        """Return the true camera of a scene."""
        return self._drifting(self.inner.load(name))[1]

    def _drifting(self, scene: Scene) -> tuple[Scene, CameraTruth]:
        return drifting(scene, self.errors, self.seed, self.noise_degC)


def drifting(clean: Scene, errors: ThermalErrors, seed: int, noise_degC: float = 0.0) -> tuple[Scene, CameraTruth]:
    """Return the scene as a camera with the given errors shows it, and that camera.

    The range grows, so that nothing is clipped, unless the encoding is `range`; with gain control, there is none. The
    given scene's temperatures become the true ones, unless it has truer ones. Raises SceneError for a scene that is not
    gray and in °C.
    """
    views, given = clean.views, _range_of(clean)
    sizes = {(view.camera.width, view.camera.height) for view in views}
    if len(sizes) > 1:
        raise SceneError(f"{clean.name} has images of several sizes: a camera has one vignette; set data.width")
    camera = errors.drawn(sizes.pop(), (given.min, given.max), np.zeros(len(views)), [seed])
    rng = np.random.default_rng([seed, NOISE])
    noises = [rng.normal(0, noise_degC, camera.pattern.shape) for _ in views]
    shown = [camera.shown(in_degC(view, given), index, noises[index]) for index, view in enumerate(views)]
    measured = [degC if view.valid is None else degC[view.valid] for degC, view in zip(shown, views, strict=True)]
    values, span, ends = _encoded(errors.encoding, shown, measured, given)
    images = {view.name: image for view, image in zip(views, values, strict=True)}

    def seen(view: View) -> View:
        image = np.repeat(images[view.name].astype(np.float32)[..., None], clean.channels, axis=2)
        truth = view.load_true_temperature or (lambda: in_degC(view, given).astype(np.float32))
        return view.with_thermal(image, load_true_temperature=truth)

    train, test = ([seen(view) for view in part] for part in (clean.train, clean.test))
    truth = CameraTruth(list(images), replace(camera, limits=ends))
    known = "each view stretched, of unknown °C"
    if span is not None:
        known = f"0 and 1 are {span.min:.4g} and {span.max:.4g} °C"
    assumed = {key: said for key, said in clean.assumed.items() if key != "range"}
    assumed["values"] = f"gray, with errors of a thermal camera; {known}"
    return replace(clean, train=train, test=test, temperature=span, assumed=assumed), truth


def _range_of(clean: Scene) -> TemperatureRange:
    """Return the range of a scene that is gray and in °C. Raises SceneError for another."""
    colored = clean.in_palette or in_pseudo_colour(clean.views)
    if clean.temperature is None or colored:
        why = "pseudo-colour" if colored else "no temperature range; set data.temperature=[MIN,MAX]"
        raise SceneError(f"{clean.name} has {why}: errors in °C can be added to gray images of temperatures alone")
    return clean.temperature


def _encoded(
    encoding: str | None, shown: list[np.ndarray], measured: list[np.ndarray], given: TemperatureRange
) -> tuple[list[np.ndarray], TemperatureRange | None, np.ndarray | None]:
    """Return images (H, W) in [0, 1] of shown temperatures, their range, and the limits (V, 2) of gain control.

    measured: the temperatures of valid pixels, (N,) of each view. given: range of the scene.
    """
    if encoding == "agc":
        ends = [limits(degC) if degC.size else (given.min, given.max) for degC in measured]
        return [levels(degC, *pair) / 255 for degC, pair in zip(shown, ends, strict=True)], None, np.array(ends)
    if encoding == "range":
        return [levels(degC, given.min, given.max) / 255 for degC in shown], given, None
    low, high = (float(end([end(degC) for degC in measured if degC.size])) for end in (np.min, np.max))
    span = TemperatureRange(low - ROOM, high + ROOM)
    return [(degC - span.min) / (span.max - span.min) for degC in shown], span, None


def in_degC(view: View, span: TemperatureRange) -> np.ndarray:
    """Return temperatures (H, W) of a view, °C."""
    return span.min + (span.max - span.min) * view.thermal.mean(axis=2, dtype=np.float64)
