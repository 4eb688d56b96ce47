"""Scores of a method's views; `views.csv`: the scores of each test view; `log.csv`: lines of the training."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from tdgbench.cells.read_files import read_table
from tdgbench.cells.record import LARGEST_SCORE
from tdgbench.cells.renders import render_images
from tdgbench.scenes import Scene
from tdgbench.scoring import METRICS, TRAIN_METRICS, Scorer, Scores, mean_scores
from tdgbench.scoring.scored_view import NotApplicableError
from tdgbench.splats.cpu import pool
from tdgbench.text import csv_text, from_csv, shortened
from tdgbench.thermal import IDEAL, ImageResponse
from tdgbench.training.loop import TrainingLog
from tdgbench.training.trainer import Trainer

Row = Scores  # of views.csv
VIEWS_A_THREAD = 2  # training views that are rendered before they are scored together


def score_views(trainer: Trainer, scene: Scene, scorer: Scorer, response: ImageResponse = IDEAL) -> dict[str, Scores]:
    """Render and score the test views of a scene; scores by view and metric, None where a metric has no value.

    Nothing is said on what the training views determine, which takes a pass over all of them.
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
            scorer.missing |= {f"train_{metric}": str(error) for metric in TRAIN_METRICS}
            return dict.fromkeys(TRAIN_METRICS)
        scores |= scorer.score_train(views, renders)
    return mean_scores(scores, TRAIN_METRICS)


def batches(count: int) -> list[tuple[int, int]]:
    """Return pieces (start, stop) of range(count): VIEWS_A_THREAD for each thread.

    >>> all(stop - start <= VIEWS_A_THREAD * pool.get_threads() for start, stop in batches(1000))
    True
    """
    size = VIEWS_A_THREAD * pool.get_threads()
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def write_views(path: Path, scores: dict[str, Scores]) -> None:
    """Write one row per view; n/a where a metric has no value."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["view", *METRICS])
        for name, values in scores.items():
            writer.writerow([csv_text(name), *("n/a" if values[m] is None else values[m] for m in METRICS)])


def read_views(path: Path) -> dict[str, Row]:
    """Return scores by view and metric from views.csv, None for n/a.

    Raises ValueError for a file of any other form (a repeated view or column, a row that is too short, no number), and
    FileNotFoundError where there is none.
    """
    rows = read_table(path)
    if not rows or not rows[0] or rows[0][0] != "view" or len(set(rows[0])) != len(rows[0]):
        raise ValueError("its first line is not `view` and the names of metrics")
    found: dict[str, Row] = {}
    for row in rows[1:]:
        name = from_csv(row[0])
        if name in found:
            raise ValueError(f"it has two rows of {name}")
        places = zip(rows[0][1:], row[1:], strict=True)
        found[name] = {m: None if text == "n/a" else finite_field(text, f"{m} of {name}") for m, text in places}
    return found


def write_log(path: Path, log: TrainingLog) -> None:
    """Write one row per logged iteration; one column per loss term."""
    terms = sorted({term for line in log.lines for term in line.terms})
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", "seconds", "loss", "smoothed_psnr", "gaussians", *(f"loss_{t}" for t in terms)])
        for line in log.lines:
            values = [line.terms.get(term, "") for term in terms]
            writer.writerow([line.iteration, round(line.seconds, 3), line.loss, line.psnr, line.gaussians, *values])


def finite_field(text: str, what: str) -> float:
    """Return a number from a CSV field. Raises ValueError, naming it by `what`, if it is none or out of range."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST_SCORE:  # NaN included
        raise ValueError(f"{what} is {shortened(text, 60)!r}, which is no finite number up to {LARGEST_SCORE:g}")
    return value
