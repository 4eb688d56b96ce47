"""Renders of a method's views and their scores; the renders of test views, and what belongs to them, as PNG."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from tdgbench.cells.paths import DETERMINACY, MASKS, files_of
from tdgbench.scenes import Scene, View
from tdgbench.scenes.modalities import OTHERS, THERMAL, image_of
from tdgbench.scoring import RenderedImages, Scorer, Scores, mean_scores, to_8bit
from tdgbench.scoring.scored_view import NotApplicableError
from tdgbench.splats.cpu import pool
from tdgbench.splats.determinacy import Determinacy
from tdgbench.thermal import IDEAL, ImageResponse
from tdgbench.training.images import MODALITIES
from tdgbench.training.trainer import Trainer

VIEWS_A_THREAD = 2  # training views that are rendered before they are scored together


def score_views(trainer: Trainer, scene: Scene, scorer: Scorer, response: ImageResponse = IDEAL) -> dict[str, Scores]:
    """Render and score the test views of a scene; scores by view and metric, None where a metric has no value.

    Determinacy is left out: it takes a pass over all training views.
    """
    return scorer.score(scene, {view.name: render_images(trainer, view, response) for view in scene.test})


def score_training_views(trainer: Trainer, scene: Scene, scorer: Scorer, response: ImageResponse = IDEAL) -> Scores:
    """Return mean PSNR and SSIM of the training views, far higher than on test views for a model that overfits.

    None for a method that has no renders of them; the reason is in the scorer's `missing`.
    """
    scores: dict[str, Scores] = {}
    for start, stop in batches(len(scene.train)):  # all renders of a large scene would take gigabytes
        views = scene.train[start:stop]
        try:
            renders = {view.name: render_images(trainer, view, response, others=()) for view in views}
        except NotApplicableError as error:
            scorer.missing |= {f"train_{metric}": str(error) for metric in scorer.train_metrics}
            return dict.fromkeys(scorer.train_metrics)
        scores |= scorer.score_train(views, renders)
    return mean_scores(scores, scorer.train_metrics)


def batches(count: int) -> list[tuple[int, int]]:
    """Return pieces (start, stop) of range(count): VIEWS_A_THREAD for each thread.

    >>> all(stop - start <= VIEWS_A_THREAD * pool.get_threads() for start, stop in batches(1000))
    True
    """
    size = VIEWS_A_THREAD * pool.get_threads()
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def render_views(trainer: Trainer, views: list[View], response: ImageResponse = IDEAL) -> dict[str, RenderedImages]:
    """Render each view, by name, in all of the method's modalities, with its determinacy if the method has Gaussians.

    response: of the thermal camera.
    """
    renders = {view.name: render_images(trainer, view, response) for view in views}
    if THERMAL not in trainer.gaussians:
        return renders
    cameras = (view.camera for view in trainer.context.scene.train)
    known = Determinacy.of_model(trainer.gaussians[THERMAL].gaussians, cameras)
    return {view.name: replace(renders[view.name], determinacy=known.image(view.camera).numpy()) for view in views}


@torch.no_grad()
def render_images(
    trainer: Trainer, view: View, response: ImageResponse = IDEAL, others: Iterable[str] = OTHERS
) -> RenderedImages:
    """Render the thermal image (H, W, C) and the expected depth (H, W, world units) of a view.

    others: modalities whose images are rendered as well, if the method has them.
    """
    method, frame = trainer.method, trainer.context.frame(view)
    render = method.render(frame).cpu()
    if render.depth is None and method.trains:
        raise TypeError(f"{method.name}.render gives no depth; a method must render depth with the image")
    images = {THERMAL: render.image.numpy()}
    images |= {name: method.render(frame, name).cpu().image.numpy() for name in others if name in method.modalities}
    for name, image in images.items():
        expected = view.camera.height, view.camera.width, MODALITIES[name].channels(trainer.context.scene)
        if image.shape != expected:
            raise TypeError(f"{method.name}.render gives {image.shape} for {name} of view {view.name}, not {expected}")
    image = images.pop(THERMAL)
    return RenderedImages(response.shown(image, view.name), render.expected_depth, images, response.temperatures(image))


def write_renders(renders: dict[str, RenderedImages], views: list[View], folder: Path) -> None:
    """Write each view to `folder` as PNG, in the folders of `files_of` each modality that it was rendered in.

    A view with masked pixels has its mask in masks/; its render is whole. Determinacy goes to determinacy/, 255 for 1.
    """
    for view in views:
        images = renders[view.name]
        _write_pair(folder, THERMAL, view.name, images.image, view.thermal)
        if view.valid is not None:  # 255 where a thermal value was measured, else 0
            _write_picture(folder, MASKS, view.name, view.valid[..., None].astype(np.float32))
        if images.determinacy is not None:
            _write_picture(folder, DETERMINACY, view.name, images.determinacy[..., None])
        for modality, image in images.others.items():
            target = image_of(view, modality)
            if target is not None:
                _write_pair(folder, modality, view.name, image, target)


def _write_pair(folder: Path, modality: str, name: str, image: np.ndarray, target: np.ndarray) -> None:
    files = files_of(modality)
    for sub, values in ((files.renders, image), (files.targets, target)):
        _write_picture(folder, sub, name, values)


def _write_picture(folder: Path, sub: str, name: str, values: np.ndarray) -> None:
    path = folder / sub / f"{name}.png"
    path.parent.mkdir(exist_ok=True)
    pixels = to_8bit(values)
    Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else pixels).save(path)
