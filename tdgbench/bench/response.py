"""What a cell does about the thermal camera's response: correct training views, and tell the record what was found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tdgbench.scenes import Scene
from tdgbench.thermal import ThermalCamera, Unknown, corrected, estimate_camera
from tdgbench.thermal.estimate import units
from tdgbench.training.camera import CameraOptions, IdealCamera, RefinedCamera

SUMMARY_SIZE = 64, 48  # px, of the vignette whose span is told
Facts = dict[str, Any]


class Prepared(NamedTuple):
    """A scene to train on, what is to be done about its camera, facts for the record, notes."""

    scene: Scene
    options: CameraOptions
    facts: Facts
    notes: list[str]


def prepare(scene: Scene, options: CameraOptions) -> Prepared:
    """Estimate the camera; correct the training views if that is asked for.

    Only terms that the estimate supports are refined: in a capture that has no drift, they would learn the errors of an
    unfinished scene. Where the camera cannot be estimated, images stay as they are and all terms are refined.
    """
    if not options.estimate and options.refine is None:
        return Prepared(scene, options, {}, [])
    found = estimate_camera(scene)
    if isinstance(found, Unknown):
        notes = [f"camera: images stay as they are: {found.reason}"] if options.estimate else []
        return Prepared(scene, options, {"unknown": found.reason}, notes)
    notes = []
    if options.refine is not None:
        terms = [term for term in options.refine.terms if term in found.terms]
        options = replace(options, refine=replace(options.refine, terms=terms) if terms else None)
        if not terms:
            notes.append("camera: nothing is refined: sparse points show no drift between views and no vignette")
    if options.estimate:
        before, scene = len(scene.notes), corrected(scene, found)
        notes += [f"camera: {note}" for note in scene.notes[before:]]
    return Prepared(scene, options, _estimated(found), notes)


def refined_facts(camera: IdealCamera, scene: Scene) -> Facts:
    """What training learned about the camera, in °C where the scene has temperatures; empty if it learned nothing."""
    if not isinstance(camera, RefinedCamera):
        return {"unknown": camera.reason} if camera.reason else {}
    unit, scale, _ = units(scene)
    first = scene.train[0].camera
    vignette = scale * camera.map(first.width, first.height)
    return {"unit": unit, **_summary(scale * camera.offsets, camera.gains, vignette)}


def _estimated(camera: ThermalCamera) -> Facts:
    return {
        "unit": camera.unit, "terms": list(camera.terms),
        **_summary(camera.offsets, camera.gains, camera.map(*SUMMARY_SIZE)),
        "residual_before": round(camera.residual_before, 5), "residual_after": round(camera.residual_after, 5),
    }  # fmt: skip


def _summary(offsets: np.ndarray, gains: np.ndarray, vignette: np.ndarray) -> Facts:
    """Offsets (V,) and vignette (H, W) in the scene's unit."""
    return {
        "offset_rms": round(float(np.sqrt(np.mean(offsets**2))), 5),
        "offset_range": [round(float(offsets.min()), 5), round(float(offsets.max()), 5)],
        "gain_range": [round(float(gains.min()), 5), round(float(gains.max()), 5)],
        "vignette_span": round(float(np.ptp(vignette)), 5),
    }
