"""Set a training up: images, thermal camera, depth priors, initial points, models, compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.backend_check.choose import training_backend
from tdgbench.bench.init import InitialPoints
from tdgbench.cells.prior_sources import POINTS
from tdgbench.priors import DepthPrior, PriorError, estimate_all
from tdgbench.priors.known_depth import doubts_of
from tdgbench.scenes import Scene, SceneError, View
from tdgbench.thermal import IDEAL, ImageResponse, ThermalCamera, Unknown, corrected, estimate_camera
from tdgbench.thermal.maps import evaluate
from tdgbench.training.context import Context
from tdgbench.training.method import Method
from tdgbench.training.skips import Skips
from tdgbench.training.trainer import Trainer
from tdgbench.training.trial import try_rig

SPAN_SIZE = 64, 48  # px, of the vignette whose span is recorded
DIGITS = 6


class Training(NamedTuple):
    """A method that is ready to train.

    scored: the scene as it is scored, with images as the thermal camera showed them. response: that camera's.
    """

    trainer: Trainer
    scored: Scene
    response: ImageResponse = IDEAL


class SetupObserver:
    """Receives the progress and the facts of a set-up; this one ignores them."""

    def phase(self, name: str) -> AbstractContextManager[None]:
        """Enter a phase: images, thermal_camera, prior, init, compile or rig."""
        return nullcontext()

    def count(self, done: int, total: int) -> None:
        """Called after each of the phase's views."""

    def note(self, field: str, facts: dict[str, Any], notes: Sequence[str] = ()) -> None:
        """Called with facts for the record once they are known.

        field: `thermal_camera` (whose parts are `estimated` and `rig`), `prior` or `init_points`.
        """

    def doubt(self, doubts: Sequence[str]) -> None:
        """Called with why the depth priors may be wrong."""


def set_up(
    cfg: DictConfig,
    scene: Scene,
    *,
    method: Method | None = None,
    skips: Skips | None = None,
    prior_cache: Path | None = None,
    observer: SetupObserver | None = None,
    compiles: bool = True,
) -> Training:
    """Make a method ready to train on a scene, whose training images `thermal_camera` corrects first.

    method: instance to set up, by default the configured one. skips: by default all are allowed. prior_cache: folder
    of estimated priors, by default they are estimated again. compiles: compile the kernels now, so that training does
    not pay for it.
    """
    torch.backends.cudnn.allow_tf32 = False  # by default convolutions on a GPU keep 10 bits of what they multiply
    observer, skips = observer or SetupObserver(), skips or Skips()
    budget, options = instantiate(cfg.budget), instantiate(cfg.thermal_camera)
    method = instantiate(cfg.method.method) if method is None else method
    method.name = str(cfg.method.name)
    if options.rig is True and not method.can_learn_rig:
        raise ValueError(f"{method.name} cannot learn the rig of the thermal camera: use thermal_camera.rig=false")
    with observer.phase("images"):  # all of them, so that a broken image fails here and training does not wait
        _read_images(scene, method, skips)
    ideal, response = _correct_thermal_camera(scene, method, options, observer)
    priors = _estimate_priors(cfg, ideal, skips, prior_cache, observer) if method.needs_prior else {}
    backend = training_backend(cfg.backend.name)
    with observer.phase("init"):
        init: InitialPoints = instantiate(cfg.init.points)
        cloud = init.points(ideal)
        context = Context(
            ideal, cloud, priors, budget, backend, int(cfg.seed), skips, method.keeps_all_points,
            method.keeps_full_resolution,
        )  # fmt: skip
        observer.note("init_points", init.describe(ideal, cloud))
    if compiles and method.trains:
        with observer.phase("compile"):
            method.compile_kernels(ideal, budget, backend)
    context.learns_rig = _learns_rig(options, method, context, observer)
    with observer.phase("init"):
        trainer = Trainer(method, context)
    return Training(trainer, scene, response)


def loader_of(cfg: DictConfig, skips: Skips) -> DictConfig:
    """Return the configuration of the scene loader; without the skip `gray`, thermal images get three channels."""
    loader = read = cfg.dataset.loader.copy()
    while "inner" in read:  # of a data set that another one reads
        read = read.inner
    if not skips.gray.allowed and read.options.channels == "auto":
        read.options.channels = 3
    return loader


def _read_images(scene: Scene, method: Method, skips: Skips) -> None:
    for view in scene.views:
        _check_image(view.thermal, view, scene.channels, f"the thermal image of view {view.name} of {scene.name}")
    for view in scene.train:
        if view.valid is not None and not view.valid.any():
            raise SceneError(
                f"training view {view.name} of {scene.name} has no valid pixel, so that nothing can be trained on it; "
                "correct its mask or its thermal values, or remove the view"
            )
    for view in _rgb_views(scene, method, skips):
        _check_image(view.rgb, view, 3, f"the RGB image of view {view.name} of {scene.name}")


def _check_image(image: np.ndarray, view: View, channels: int, what: str) -> None:
    """Raise SceneError for an image of another shape than its camera's, or with values that are not finite."""
    expected = view.camera.height, view.camera.width, channels
    if image.shape != expected:
        raise SceneError(f"{what} is {image.shape}, by its camera it is {expected} (height, width, channels)")
    wrong = image.size - int(np.isfinite(image).sum())
    if wrong:
        raise SceneError(f"{what} is not finite in {wrong} of {image.size} values; give the view a mask (load_valid)")


def _rgb_views(scene: Scene, method: Method, skips: Skips) -> list[View]:
    """Return views whose RGB image is read.

    A method with RGB needs that of every view that it trains on, and scores those of the test views that have one.
    For other methods the skip `rgb` leaves all out; without it, those of the training views are read.
    """
    if "rgb" in method.modalities:
        return (scene.train if method.trains else []) + [view for view in scene.test if view.load_rgb is not None]
    available = [view for view in scene.train if view.load_rgb is not None]
    reason = "the method trains on thermal images alone"
    return [] if skips.rgb.decide(bool(available), reason, f"{len(available)} images") else available


def _correct_thermal_camera(
    scene: Scene, method: Method, options: ThermalCameraOptions, observer: SetupObserver
) -> tuple[Scene, ImageResponse]:
    """Return the scene as an ideal thermal camera would show it, and the response that renders pass through.

    Where the camera cannot be estimated, images stay as they are. Raises SceneError for options of a method that does
    not train.
    """
    if not method.trains and (options.estimate or options.rig):
        raise SceneError(
            f"thermal_camera= changes what is trained on, and {method.name} does not train; use thermal_camera=ideal"
        )
    if not options.estimate:
        return scene, IDEAL
    with observer.phase("thermal_camera"):
        estimate, before, response = estimate_camera(scene), len(scene.notes), IDEAL
        if isinstance(estimate, Unknown):
            facts: dict[str, Any] = {"unknown": estimate.reason}
            notes = [f"images stay as they are: {estimate.reason}"]
        else:
            scene, response = corrected(scene, estimate)
            facts, notes = _as_recorded(estimate), list(scene.notes[before:])
    if response != IDEAL:
        facts["response"] = response.as_json()
    observer.note("thermal_camera", {"estimated": facts}, [f"thermal camera: {note}" for note in notes])
    return scene, response


def _learns_rig(options: ThermalCameraOptions, method: Method, context: Context, observer: SetupObserver) -> bool:
    """Return whether the pose and lens of the thermal camera are learnt; of `auto`, a trial decides."""
    if options.rig != "auto":
        return options.rig
    with observer.phase("rig"):
        trial = try_rig(method, context)
    note = f"thermal camera: the rig is {'' if trial.pays else 'not '}learnt: {trial.reason}"
    observer.note("thermal_camera", {"rig": asdict(trial)}, [note])
    return trial.pays


def _estimate_priors(
    cfg: DictConfig, scene: Scene, skips: Skips, cache: Path | None, observer: SetupObserver
) -> dict[str, DepthPrior]:
    """Return the depth priors of the training views by name, from the cache where it has them."""
    with observer.phase("prior"):
        estimator = instantiate(cfg.prior.estimator)
        priors, estimated = estimate_all(estimator, scene, cache if skips.prior.allowed else None, observer.count)
        views, cached = len(scene.train), len(scene.train) - estimated
        reason = f"{cached} of {views} training views were estimated before; test views need no prior"
        skips.prior.decide(cached > 0, reason, f"{cached} estimates")
        kind = next(iter(priors.values())).kind
        observer.note("prior", {**estimator.identity(scene), "kind": kind, "made_from": cfg.prior.made_from})
        if cfg.prior.made_from != POINTS:  # which cannot contradict themselves
            observer.doubt([*doubts_of(priors, scene)])
    return {view.name: _where_valid(priors[view.name], view) for view in scene.train}


def _where_valid(prior: DepthPrior, view: View) -> DepthPrior:
    """Return the prior without its depths at masked pixels, where the image that it was made from has no values.

    Raises PriorError if it is known nowhere else.
    """
    if view.valid is None:
        return prior
    values = np.where(view.valid, prior.values, np.float32(np.nan))
    if not np.isfinite(values).any():
        raise PriorError(f"the depth prior of view {view.name} is known at none of the view's valid pixels")
    return DepthPrior(values, prior.kind)


@dataclass(frozen=True)
class ThermalCameraOptions:
    """What is done about the thermal camera's errors; see `conf/thermal_camera/`."""

    estimate: bool  # its response, before training, from sparse points; training views are then corrected
    rig: bool | Literal["auto"] = False  # learn its pose and lens with the Gaussians; auto: if `try_rig` finds a gain


def _as_recorded(camera: ThermalCamera) -> dict[str, Any]:
    """Return the estimate of a thermal camera as a record keeps it."""
    return {
        "unit": camera.unit, "terms": list(camera.terms), "undetermined": camera.undetermined,
        "views": list(camera.views), "reference": round(float(camera.reference), DIGITS),
        "offsets": _rounded(camera.offsets), "gains": _rounded(camera.gains), "vignette": _rounded(camera.vignette),
        "offset_rms": round(float(np.sqrt(np.mean(camera.offsets**2))), DIGITS),
        "vignette_span": round(float(np.ptp(evaluate(camera.vignette, *SPAN_SIZE))), DIGITS),
        "residual_before": round(camera.residual_before, 5), "residual_after": round(camera.residual_after, 5),
    }  # fmt: skip


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
