"""What a cell does about the thermal camera's response: correct training views, and tell the record what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tdgbench.scenes import Scene
from tdgbench.thermal import ImageResponse, ThermalCamera, Unknown, corrected, estimate_camera
from tdgbench.thermal.estimate import units
from tdgbench.thermal.polynomials import evaluate
from tdgbench.training.camera import CameraOptions, IdealCamera, RefinedCamera, Refinement

SPAN_SIZE = 64, 48  # px, of the vignette whose span is told
DIGITS = 6
Facts = dict[str, Any]
IDEAL = ImageResponse()


class Prepared(NamedTuple):
    """A scene to train on, what is to be done about its camera, facts for the record, notes, response for renders."""

    scene: Scene
    options: CameraOptions
    facts: Facts
    notes: list[str]
    response: ImageResponse = IDEAL


def prepare(scene: Scene, options: CameraOptions) -> Prepared:
    """Estimate the camera; correct the training views if that is asked for.

    Only terms that the estimate supports are refined: in a capture that has no drift, they would learn the errors of an
    unfinished scene. Where the camera cannot be estimated, images stay as they are and all that was asked for is
    refined.
    """
    found = estimate_camera(scene)
    if isinstance(found, Unknown):
        notes = [f"camera: images stay as they are: {found.reason}"] if options.estimate else []
        return Prepared(scene, options, {"unknown": found.reason}, notes)
    notes = []
    if options.refine is not None:
        refine = _supported(options.refine, found)
        if refine is None:
            wanted = ", ".join(options.refine.terms) or "more"
            notes.append(f"camera: nothing is refined: sparse points do not support {wanted}")
        options = replace(options, refine=refine)
    if options.estimate:
        before = len(scene.notes)
        scene, response = corrected(scene, found)
        notes += [f"camera: {note}" for note in scene.notes[before:]]
        return Prepared(scene, options, _estimated(found) | {"response": response.as_json()}, notes, response)
    return Prepared(scene, options, _estimated(found), notes)


def _supported(refinement: Refinement, found: ThermalCamera) -> Refinement | None:
    """What is left of a refinement; None if that is nothing."""
    terms = [term for term in refinement.terms if term in found.terms]
    return replace(refinement, terms=terms) if terms else None


def refined_facts(camera: IdealCamera, scene: Scene) -> Facts:
    """What training learned about the camera, in °C where the scene has temperatures; empty if it learned nothing."""
    if not isinstance(camera, RefinedCamera):
        return {"unknown": camera.reason} if camera.reason else {}
    unit, scale, zero = units(scene)
    return {
        "unit": unit, "terms": list(camera.refinement.terms),
        **_numbers(
            camera.names, scale * camera.reference + zero, scale * camera.offsets, camera.gains,
            scale * camera.vignette.values[0],
        ),
    }  # fmt: skip


def too_short(camera: IdealCamera) -> list[str]:
    """A note if training ended before it began to learn all of the camera."""
    if not isinstance(camera, RefinedCamera) or not camera.not_begun:
        return []
    rounds = f"{camera.rounds:.0f} rounds of the views"
    return [f"camera: training ended after {rounds}, too soon to learn {', '.join(camera.not_begun)}"]


def _estimated(camera: ThermalCamera) -> Facts:
    pattern = {"columns": camera.columns, "rows": camera.rows}
    return {
        **{name: _rounded(lines) for name, lines in pattern.items() if lines is not None},
        "unit": camera.unit, "terms": list(camera.terms), "undetermined": camera.undetermined,
        **_numbers(camera.views, camera.reference, camera.offsets, camera.gains, camera.vignette),
        "residual_before": round(camera.residual_before, 5), "residual_after": round(camera.residual_after, 5),
    }  # fmt: skip


def _numbers(
    views: Sequence[str], reference: float, offsets: np.ndarray, gains: np.ndarray, vignette: np.ndarray
) -> Facts:
    """Offsets and gains (V,) of views at a reference, coefficients (K,) of the vignette; all in the scene's unit."""
    return {
        "views": list(views), "reference": round(float(reference), DIGITS),
        "offsets": _rounded(offsets), "gains": _rounded(gains), "vignette": _rounded(vignette),
        "offset_rms": round(float(np.sqrt(np.mean(offsets**2))), DIGITS),
        "vignette_span": round(float(np.ptp(evaluate(vignette, *SPAN_SIZE))), DIGITS),
    }  # fmt: skip


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
