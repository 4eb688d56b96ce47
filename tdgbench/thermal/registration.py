"""The rig of a thermal camera: how it differs from the camera of the model, from training views and sparse points.

In RGB-thermal captures poses and points are those of the RGB camera, and the thermal images were registered to it by one
mapping for all distances. The thermal camera's true place, direction and lens are few numbers that all views share.
With them, the thermal values of a point agree between views: photometric bundle adjustment with fixed points, by
Gauss-Newton steps from blurred to sharp images. The temperatures of the points and the views' offsets are further
unknowns, eliminated as for the camera's response (`fit`). Learned together with a scene of Gaussians, the rig hardly
moves: the Gaussians take up its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.scenes import Camera, Scene, View
from tdgbench.scenes.rig import Rig
from tdgbench.thermal.estimate import data_of
from tdgbench.thermal.evidence import held_back
from tdgbench.thermal.explain import CUT, held_out_errors
from tdgbench.thermal.fit import Terms, fit
from tdgbench.thermal.priors import NORMAL, Widths
from tdgbench.thermal.sightings import Sightings, find_sightings

BLURS = (8.0, 4.0, 2.0, 1.0, 1.0)  # px at WIDTH, σ; one Gauss-Newton step after another
STEPS = 3  # at each blur
WIDTH = 640  # px
DEVIATIONS = (0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.003, 0.003, 0.02, 0.02)  # of rigs: turn (rad), place (median
# depths), focal length (logarithm), principal point (focal lengths), k1, k2; a prior about none
BETTER = 0.98  # share of the error of held-out views that a rig must reach


class Parameters(NamedTuple):
    """A rig as the steps change it: DEVIATIONS' numbers (P,); depth: the median, scene units; shape: focal / width."""

    values: np.ndarray
    depth: float
    shape: float

    @property
    def rig(self) -> Rig:
        turn, move, (focal, x, y, k1, k2) = self.values[:3], self.values[3:6], self.values[6:]
        back = Rotation.from_rotvec(turn).inv().as_matrix()
        return Rig(
            offset=(-self.depth * (back @ move)).tolist(), degrees=np.degrees(turn).tolist(), focal=float(np.exp(focal)),
            center=[float(x * self.shape), float(y * self.shape)], distortion=[float(k1), float(k2)],
        )  # fmt: skip


class Registration(NamedTuple):
    """An estimated rig. error_before, error_after: of held-out views, shares of the contrast of the scene's points.

    offset_px: mean distance in the images, px at their size, between points without and with the rig.
    """

    rig: Rig
    error_before: float
    error_after: float
    offset_px: float
    undetermined: int

    @property
    def is_supported(self) -> bool:
        """Whether views are predicted clearly better with the rig by views that the prediction is not made from."""
        return self.error_after < BETTER * self.error_before


def register(scene: Scene) -> Registration:
    """Estimate the rig of a scene with points from its training views. Test views are not read."""
    assert scene.points is not None
    points, camera = scene.points.points, scene.train[0].camera
    scale = camera.width / WIDTH
    z = np.concatenate([_depths(view.camera, points) for view in scene.train])
    start = Parameters(np.zeros(len(DEVIATIONS)), float(np.median(z)), float(camera.K[0, 0]) / camera.width)
    found, undetermined = start, 0
    for blur in BLURS:
        for _ in range(STEPS):
            found, undetermined = _step(scene, found, max(blur * scale, 0.7))
    errors = [_held_out_error(scene, one.rig) for one in (start, found)]
    moved = [np.linalg.norm(_moved(view.camera, found.rig, points), axis=1) for view in scene.train]
    return Registration(found.rig, *errors, float(np.mean(np.concatenate(moved))), undetermined)


def _step(scene: Scene, at: Parameters, blur: float) -> tuple[Parameters, int]:
    """One Gauss-Newton step, and the directions that the images do not determine.

    With parameters p, values of the points' places move from v to v + J (p − at); they are temperature + offset. So
    v − J at = temperature + offset − J p, the model of `fit` with −J for polynomials and p for their coefficients.
    """
    seen = find_sightings(scene.train, scene.points.points, at.rig, blur)
    data = data_of(scene.train, seen, 1.0, 0.0)
    jacobian = _jacobian(scene.train, seen, at)
    data = replace(data, value=data.value - jacobian @ at.values, terms=-jacobian)
    widths = Widths.of("image", float(np.std(seen.value)) or 1.0)
    deviations = np.r_[np.full(data.views, widths.offsets), np.full(data.views, widths.gains), DEVIATIONS]
    terms, precision = Terms(vignette=True, offsets=True), np.diag(1 / deviations**2)
    found = held_back(data, fit(data, terms, precision), terms, precision)
    return at._replace(values=found.vignette), found.undetermined


def _jacobian(views: Sequence[View], seen: Sightings, at: Parameters) -> np.ndarray:
    """Derivative (S, P) of values by the parameters: the image's gradient times the movement of the point in it.

    A point at x of the camera's axes moves by ω × x and by τ.
    """
    cameras = [at.rig.camera(view.camera) for view in views]
    focal = np.array([camera.K[[0, 1], [0, 1]] for camera in cameras])[seen.view]
    middle = np.array([camera.K[:2, 2] for camera in cameras])[seen.view]
    given = np.array([view.camera.K[0, 0] for view in views])[seen.view]
    u, v = ((np.stack([seen.x, seen.y], axis=1) - middle) / focal).T
    near, stretch = at.depth / seen.z, given / focal[:, 0]
    square, zero = u**2 + v**2, np.zeros_like(u)
    across = [-u * v, 1 + u**2, -v, near, zero, -u * near, u, stretch, zero, u * square, u * square**2]
    down = [-(1 + v**2), u * v, u, zero, near, -v * near, v, zero, stretch, v * square, v * square**2]
    by_x, by_y = seen.right * focal[:, 0], seen.down * focal[:, 1]
    return np.stack([by_x * a + by_y * b for a, b in zip(across, down, strict=True)], axis=1)


def _held_out_error(scene: Scene, rig: Rig) -> float:
    """Error of held-out views after the gain and offset of their other half, over the contrast of the points."""
    data = data_of(scene.train, find_sightings(scene.train, scene.points.points, rig), 1.0, 0.0)
    widths = Widths.of("image", float(np.std(data.value)) or 1.0)
    _, halves = held_out_errors(data, Terms(offsets=True), widths, np.full(data.views, np.nan))
    cut = CUT * NORMAL * float(np.median(np.abs(halves)))
    return float(np.sqrt(np.mean(np.minimum(halves**2, cut**2)))) / float(np.std(data.value))


def _depths(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Depths (N,) of the points in front of a camera, in its image."""
    pixels, z = camera.project(points)
    inside = (z > 0) & (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    return np.asarray(z[inside])


def _moved(camera: Camera, rig: Rig, points: np.ndarray) -> np.ndarray:
    """How far (N, 2) in px a rig moves the points in a camera's image."""
    before, z = camera.project(points)
    inside = (z > 0) & (before >= 0).all(axis=1) & (before < [camera.width, camera.height]).all(axis=1)
    thermal = rig.camera(camera)
    after, _ = thermal.project(points[inside])
    return np.asarray(rig.distorted(after, thermal.K) - before[inside])
