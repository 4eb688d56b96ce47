"""Scores of a method's views, and `views.csv`: the scores of each test view."""

from __future__ import annotations

import csv
from pathlib import Path

from tdgbench.bench.renders import render_images, render_views
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, TRAIN_METRICS, Scorer, mean_scores
from tdgbench.training.method import Method


def score_views(method: Method, scene: Scene, scorer: Scorer) -> dict[str, dict[str, float | None]]:
    """Render and score the test views of a scene; scores by view and metric, None where a metric has no value."""
    return scorer.score(scene, render_views(method, scene.test))


def score_training_views(method: Method, scene: Scene, scorer: Scorer) -> dict[str, float | None]:
    """Mean PSNR and SSIM of the training views; a model that overfits scores far higher here than on test views."""
    scores = {view.name: scorer.score_train(view, render_images(method, view, with_rgb=False)) for view in scene.train}
    return mean_scores(scores, TRAIN_METRICS)


def write_views(path: Path, scores: dict[str, dict[str, float | None]]) -> None:
    """Write one row per view; n/a where a metric has no value."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["view", *METRICS])
        for name, values in scores.items():
            writer.writerow([name, *("n/a" if values[m] is None else values[m] for m in METRICS)])
