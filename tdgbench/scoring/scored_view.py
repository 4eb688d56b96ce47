"""Input of a metric: a rendered view, its ground truth, its scene, and the scoring convention."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from tdgbench.scenes import Scene, View
from tdgbench.scenes.modalities import LABELS, THERMAL, image_of

Border = Literal["zero", "valid"]
ConventionName = Literal["3dgs", "standard"]  # as a record names it
CONVENTIONS = {"3dgs": ("zero", "unit"), "standard": ("valid", "signed")}  # border of SSIM, range of LPIPS


class NotApplicableError(Exception):
    """A metric does not apply to a view; records and tables give the message as the reason."""


@dataclass(frozen=True)
class RenderedImages:
    """A method's renders of one view.

    image: (H, W, C) float32 with the response of the thermal camera, not clipped. depth: (H, W) expected z in scene
    units, 0 where nothing was rendered; None: the renders are images alone. others: (H, W, C) float32 of the method's
    models of other modalities, by modality. without_response: (H, W, C) float32, the render before that response; None:
    equal to `image`. determinacy: (H, W) float32 in [0, 1], how well the training views determine each pixel
    (`tdgbench.splats.determinacy`); None: the method has no Gaussians.
    """

    image: np.ndarray
    depth: np.ndarray | None
    others: Mapping[str, np.ndarray] = field(default_factory=dict)
    without_response: np.ndarray | None = None
    determinacy: np.ndarray | None = None

    @property
    def ideal(self) -> np.ndarray:
        """(H, W, C), the render as an ideal camera would show it."""
        return self.image if self.without_response is None else self.without_response

    @property
    def known_depth(self) -> np.ndarray:
        """`depth`. Raises NotApplicableError without."""
        if self.depth is None:
            raise NotApplicableError("the renders have no depth")
        return self.depth

    @property
    def known_determinacy(self) -> np.ndarray:
        """`determinacy`. Raises NotApplicableError without."""
        if self.determinacy is None:
            raise NotApplicableError("what the training views determine is unknown: the renders are not of Gaussians")
        return self.determinacy


@dataclass(frozen=True)
class Convention:
    """How scores are computed. lpips: distance of two images (H, W, C) in [0, 1], or NotApplicableError."""

    ssim_border: Border
    lpips: Callable[[np.ndarray, np.ndarray], float]


@dataclass(frozen=True)
class ImagePair:
    """A render and its ground truth, both (H, W, C) float32 in [0, 1] as 8-bit files store them.

    valid: bool (H, W), the pixels to compare; both images are 0 elsewhere. None: all.
    """

    image: np.ndarray
    target: np.ndarray
    convention: Convention
    valid: np.ndarray | None = None

    @property
    def pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """Values of render and ground truth to compare: (N, C), or the images themselves if all are."""
        return at_valid(self.valid, self.image), at_valid(self.valid, self.target)


@dataclass(frozen=True)
class ScoredView:
    """One view with its render.

    scene, renders: all test views and their renders by name; None for a training view. common: cache of metrics for
    results about all test views, by the metric's name; the views of one scoring share it.
    """

    view: View
    rendered: RenderedImages
    convention: Convention
    scene: Scene | None = None
    renders: Mapping[str, RenderedImages] = field(default_factory=dict)
    common: dict[str, Any] = field(default_factory=dict)
    _pairs: dict[str, ImagePair] = field(default_factory=dict, init=False)  # cache of `pair`

    def pair(self, modality: str) -> ImagePair:
        """Return the pictures that a metric compares. Raises NotApplicableError without a model or image of it."""
        if modality not in self._pairs:
            self._pairs[modality] = self._thermal() if modality == THERMAL else self._other(modality)
        return self._pairs[modality]

    @property
    def valid(self) -> np.ndarray | None:
        """Bool (H, W), the pixels with a thermal value; None: all. Raises NotApplicableError if there is none."""
        if self.view.valid is not None and not self.view.valid.any():
            raise NotApplicableError(f"no pixel of view {self.view.name} has a thermal value: its mask leaves none")
        return self.view.valid

    def _thermal(self) -> ImagePair:
        image, valid = as_saved(self.rendered.image), self.valid
        if valid is not None:
            image = np.where(valid[..., None], image, np.float32(0))
        return ImagePair(image, as_saved(self.view.thermal), self.convention, valid)

    def _other(self, modality: str) -> ImagePair:
        if modality not in self.rendered.others:
            raise NotApplicableError(f"the method trains no {LABELS[modality]} model")
        target = image_of(self.view, modality)
        if target is None:
            raise NotApplicableError(f"a test view has no {LABELS[modality]} image")
        return ImagePair(as_saved(self.rendered.others[modality]), as_saved(target), self.convention)

    def depths(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the rendered and true z of the valid pixels, the latter float64.

        Raises NotApplicableError where either is unknown, or they differ in size.
        """
        truth = self.view.true_depth
        if truth is None:
            raise NotApplicableError("the scene has no true depth")
        if truth.shape != self.rendered.known_depth.shape:
            raise NotApplicableError("the true depth has another size than the images")
        return at_valid(self.valid, self.rendered.known_depth), at_valid(self.valid, truth.astype(np.float64))

    def nearest_test_view(self) -> View:
        """Return the test view whose camera is nearest. Raises NotApplicableError where there is no other test view."""
        others = [] if self.scene is None else [view for view in self.scene.test if view.name != self.view.name]
        if not others:
            raise NotApplicableError("the scene has one test view")
        center = self.view.camera.center
        return min(others, key=lambda other: float(np.linalg.norm(other.camera.center - center)))


def check_convention(name: str, ssim_border: str, lpips_range: str) -> None:
    """Raise ValueError for settings that are not those of a convention: its name would state other scores.

    >>> check_convention("standard", "zero", "unit")
    Traceback (most recent call last):
    ValueError: convention standard has ssim_border=valid, lpips_range=signed: choose metrics=3dgs or metrics=standard
    """
    border, values = CONVENTIONS[name]
    if (ssim_border, lpips_range) != (border, values):
        choices = " or ".join(f"metrics={one}" for one in CONVENTIONS)
        raise ValueError(f"convention {name} has ssim_border={border}, lpips_range={values}: choose {choices}")


def at_valid(valid: np.ndarray | None, values: np.ndarray) -> np.ndarray:
    """Return the values (N, …) of (H, W, …) where the mask (H, W) is true; without a mask, the values themselves.

    >>> at_valid(np.array([[True, False]]), np.array([[[1, 2], [3, 4]]])).tolist()
    [[1, 2]]
    """
    return values if valid is None else values[valid]


def to_8bit(image: np.ndarray) -> np.ndarray:
    """Return values in [0, 1] as an 8-bit image stores them: uint8, rounded half up.

    >>> to_8bit(np.array([-0.1, 0.5 / 255, 1.0])).tolist()
    [0, 1, 255]
    """
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def as_saved(image: np.ndarray) -> np.ndarray:
    """Return an image (H, W, C) as its 8-bit file gives it back, float32 in [0, 1]. Raises ValueError for NaN."""
    if np.isnan(image).any():
        raise ValueError("an image has values that are NaN, which are no levels")
    return to_8bit(image).astype(np.float32) / np.float32(255)
