"""Estimate a scene's thermal camera before training: from its training views and sparse points alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tdgbench.scenes import Scene
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.text import first_few
from tdgbench.thermal.camera import ThermalCamera, Unknown, normalized
from tdgbench.thermal.expected_errors import Drift, ExpectedErrors, kind_of_name, sequence_positions
from tdgbench.thermal.fit import Terms
from tdgbench.thermal.observations import FEWEST_VIEWS, PointSamples, find_observations
from tdgbench.thermal.select_terms import fit_selected_terms

FEWEST_OBSERVATIONS = 20  # of a view whose gain and offset are estimated
FEWEST_TRAINING_VIEWS = 3


def estimate_camera(scene: Scene) -> ThermalCamera | Unknown:
    """Estimate the thermal camera of a scene from its training views, or say why it cannot be estimated.

    In °C where the scene has a range of temperatures, else in image units. Test views are not read.
    """
    if scene.points is None or not len(scene.points.points):
        return Unknown(
            f"{scene.name} has no sparse points, from which the thermal camera is estimated; add a COLMAP model that "
            "has some"
        )
    if len(scene.train) < FEWEST_TRAINING_VIEWS:
        return Unknown(f"{scene.name} has {len(scene.train)} training views; a camera needs {FEWEST_TRAINING_VIEWS}")
    colored = [view.name for view in scene.train] if scene.in_palette else in_pseudo_colour(scene.train)
    if colored:
        return Unknown(
            f"{scene.name}: thermal images are pseudo-coloured ({first_few(colored)}); colours are no temperatures; "
            "give gray images, or data.thermal=radiometric"
        )
    seen = _well_seen(find_observations(scene.train, scene.points.points), len(scene.train))
    counts = np.bincount(seen.view, minlength=len(scene.train))
    if np.count_nonzero(counts) < FEWEST_TRAINING_VIEWS:
        return Unknown(
            f"{scene.name}: {np.count_nonzero(counts)} training views see {FEWEST_OBSERVATIONS} or more points that "
            f"{FEWEST_VIEWS} views share; a camera needs {FEWEST_TRAINING_VIEWS}: add points, or raise data.width"
        )
    return _estimate(scene, seen)


def units(scene: Scene) -> tuple[str, float, float]:
    """Return the unit of a scene's cameras, and its values: value = scale × image value + zero."""
    if scene.temperature is None:
        return "image", 1.0, 0.0
    return "°C", scene.temperature.max - scene.temperature.min, scene.temperature.min


def _well_seen(seen: PointSamples, views: int) -> PointSamples:
    """Return the observations of views that have enough of them."""
    while True:
        counts = np.bincount(seen.view, minlength=views)
        keep = (counts >= FEWEST_OBSERVATIONS)[seen.view]
        if keep.all():
            return seen
        seen = seen.select(keep).shared()


def _estimate(scene: Scene, seen: PointSamples) -> ThermalCamera:
    (name, scale, zero), train = units(scene), scene.train
    data = replace(seen, value=scale * seen.value + zero, slope=scale * seen.slope)
    counts = np.bincount(seen.view, minlength=len(train))
    stds = ExpectedErrors.in_unit(name, float(np.std(data.value)) or 1.0)
    place = sequence_positions([view.name for view in scene.views])
    at = np.array([place[view.name] for view in train])
    fitted, terms, drift = fit_selected_terms(data, stds, at)
    response = normalized(fitted.response, counts > 0)
    if drift is None:  # else those of views without observations follow their neighbours'
        response = response._replace(offsets=np.where(counts > 0, response.offsets, 0.0))
    undetermined = max(0, fitted.undetermined - terms.offsets - terms.gains)
    expected = {}
    if drift is not None:
        kinds = {kind_of_name(view.name) for view in train}
        known, others = counts > 0, [view.name for view in scene.test if kind_of_name(view.name) in kinds]
        offsets = drift.expected(np.array([place[other] for other in others]), at[known], response.offsets[known])
        expected = dict(zip(others, offsets.tolist(), strict=True))
    return ThermalCamera(
        unit=name,
        views=tuple(view.name for view in train),
        reference=fitted.reference,
        offsets=response.offsets,
        gains=response.gains,
        vignette=fitted.vignette,
        residual_before=fitted.before,
        residual_after=fitted.after,
        expected=expected,
        terms=tuple(name for name, used in terms._asdict().items() if used),
        undetermined=undetermined,
        notes=tuple(_notes(scene, counts, terms, undetermined, drift, expected)),
    )


def _notes(
    scene: Scene,
    counts: np.ndarray,
    terms: Terms,
    undetermined: int,
    drift: Drift | None,
    expected: Mapping[str, float],
) -> list[str]:
    """Return what is not corrected, not determined, and how offsets drift. counts: (V,) observations of each view.

    expected: offsets of test views that follow the drift.
    """
    train = scene.train
    left_out = [name for name, used in terms._asdict().items() if not used]
    notes = []
    if left_out:
        notes.append(f"held-out views are predicted no better with {', '.join(left_out)}: not corrected")
    few = [view.name for view, count in zip(train, counts, strict=True) if count == 0]
    if few:
        notes.append(
            f"{len(few)} views see fewer than {FEWEST_OBSERVATIONS} points that others see; they get the response of "
            f"{'an average view' if drift is None else 'the views before and after them'}: {first_few(few)}"
        )
    if undetermined:
        directions = "1 direction" if undetermined == 1 else f"{undetermined} directions"
        notes.append(
            f"{directions} of the estimated numbers, beside mean offset and mean gain, not determined by the images: "
            "there, the camera is as near to an ideal one as can be"
        )
    if drift is not None and drift.jitter < 1:
        events = f"{len(drift.events)} shutter event{'' if len(drift.events) == 1 else 's'}"
        notes.append(
            f"offsets change over {drift.length:g} views in the order of their names, by {1 - drift.jitter:.0%} of "
            f"their variance, with {events}; those of test views are expected from this"
        )
        apart = [view.name for view in scene.test if view.name not in expected]
        if apart:
            notes.append(f"test views with other names than training views get the mean offset: {first_few(apart)}")
    return notes
