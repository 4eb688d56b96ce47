"""`tdgbench verify results/<experiment> ...`: check results against their records.

Every record must fit its schema. For a finished cell, files must have the recorded hashes, the model must give the
stored renders from the test cameras, and the stored pictures must give the stored scores.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tdgbench.bench import cameras
from tdgbench.bench.hashes import hashes
from tdgbench.bench.record import FILE, record_files, schema_problems
from tdgbench.bench.renders import render_model
from tdgbench.scenes import Camera
from tdgbench.scoring import METRICS, LPIPSOptions, Scorer, to_8bit
from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.scored_view import ImagePair, Modality, NotApplicableError
from tdgbench.splats.ply import load_ply
from tdgbench.terminal import say

MAX_DIFFERENT = 1e-3  # share of values that may differ by one of 255 levels: processors round differently
SCORE_TOLERANCE = 1e-6


def verify(experiment: Path) -> tuple[int, list[str]]:
    """Number of cells, and every problem in words. Raises ValueError if there are no cells."""
    folders = [path.parent for path in record_files(experiment)]
    if not folders:
        raise ValueError(f"{experiment} holds no records; run an experiment first")
    problems = []
    for folder in folders:
        problems += [f"{folder.relative_to(experiment / 'cells')}: {problem}" for problem in verify_cell(folder)]
    return len(folders), problems


def verify_cell(folder: Path) -> list[str]:
    """Problems of one cell; of a failed cell, only those of its record."""
    try:
        text = (folder / FILE).read_text(encoding="utf-8")
        content = json.loads(text)
    except ValueError as error:
        return [f"{FILE} is not JSON: {error}"]
    problems = [f"{FILE}: {problem}" for problem in schema_problems(text)]
    if problems or content["status"] != "ok":
        return problems
    return [*_files(folder, content), *_renders(folder), *_scores(folder, content)]


def _files(folder: Path, content: dict[str, Any]) -> Iterator[str]:
    """Files that are missing, unknown to the record, or changed."""
    actual, recorded = hashes(folder), content["hashes"]
    yield from (f"{name} is missing" for name in sorted(set(recorded) - set(actual)))
    yield from (f"{name} is not in the record" for name in sorted(set(actual) - set(recorded)))
    both = sorted(set(actual) & set(recorded))
    yield from (f"{name} has changed" for name in both if actual[name] != recorded[name])


def _renders(folder: Path) -> Iterator[str]:
    """Renders that differ from what the models give."""
    try:
        test_cameras = cameras.read_cameras(folder / cameras.FILE, "test")
        for model, renders in (("model.ply", "renders"), ("model_rgb.ply", "renders_rgb")):
            if model == "model.ply" or (folder / renders).exists():
                yield from _renders_of(folder, model, renders, test_cameras)
    except (OSError, ValueError) as error:
        yield f"cannot be rendered again: {error}"


def _renders_of(folder: Path, model: str, renders: str, test_cameras: dict[str, Camera]) -> Iterator[str]:
    gaussians = load_ply(folder / model)
    for name, camera in test_cameras.items():
        path = folder / renders / f"{name}.png"
        if not path.exists():
            continue  # reported as missing
        stored, again = _picture(path), to_8bit(render_model(gaussians, camera).image.numpy())
        if stored.shape != again.shape:
            yield f"{renders}/{name}.png is {stored.shape}, the model gives {again.shape}"
            continue
        difference = np.abs(stored.astype(int) - again.astype(int))
        if difference.max() > 1 or (difference > 0).mean() > MAX_DIFFERENT:
            share = f"{(difference > 0).mean():.1%} of the values differ, by up to {difference.max()}"
            yield f"{renders}/{name}.png is not what {model} gives: {share}"


def _picture(path: Path) -> np.ndarray:
    """Stored picture (H, W, C) uint8."""
    values = np.asarray(Image.open(path))
    return values[..., None] if values.ndim == 2 else values


def _scores(folder: Path, content: dict[str, Any]) -> Iterator[str]:
    """Scores that differ from those of the stored pictures. Scores that need more than pictures are not checked."""
    with (folder / "views.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["view"]: row for row in csv.DictReader(file)}
    metrics = content["config"]["metrics"]
    options = LPIPSOptions(metrics["lpips"]["net"], metrics["lpips"]["weights"], download=False)
    scorer = Scorer(metrics["convention"], metrics["ssim_border"], metrics["lpips_range"], options)
    computed: dict[str, list[float]] = {}
    for name, row in rows.items():
        for metric, value in _scores_of(folder, name, row, scorer).items():
            computed.setdefault(metric, []).append(value)
            if not _is_close(value, float(row[metric])):
                yield f"views.csv: {metric} of {name} is {row[metric]}, its pictures give {value:.6f}"
    for metric, values in computed.items():
        recorded = content["scores"].get(metric)
        if len(values) == len(rows) and (recorded is None or not _is_close(float(np.mean(values)), recorded)):
            yield f"{FILE}: {metric} is {recorded}, the pictures give {np.mean(values):.6f}"


def _scores_of(folder: Path, name: str, row: dict[str, str], scorer: Scorer) -> dict[str, float]:
    """A view's scores from its stored pictures; pictures that are missing are reported elsewhere."""
    found = {}
    for metric in METRICS.values():
        if not isinstance(metric, ImageMetric):
            continue
        pair = _pair(folder, name, metric.modality, scorer)
        if pair is None or row.get(metric.name, "n/a") == "n/a":
            continue
        with suppress(NotApplicableError):
            found[metric.name] = metric.of_images(pair)
    return found


def _pair(folder: Path, name: str, modality: Modality, scorer: Scorer) -> ImagePair | None:
    """A view's render and ground truth from disk; None where a file is missing."""
    suffix = "" if modality == "thermal" else f"_{modality}"
    paths = [folder / f"{sub}{suffix}" / f"{name}.png" for sub in ("renders", "targets")]
    if not all(path.exists() for path in paths):
        return None
    image, target = (_picture(path).astype(np.float32) / np.float32(255) for path in paths)
    return ImagePair(image, target, scorer.settings)


def _is_close(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=SCORE_TOLERANCE, abs_tol=SCORE_TOLERANCE)


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status."""
    parser = argparse.ArgumentParser(prog="tdgbench verify", description=__doc__)
    parser.add_argument("experiment", nargs="+", type=Path, help="folder results/<experiment>")
    status = 0
    for experiment in parser.parse_args(arguments).experiment:
        try:
            count, problems = verify(experiment)
        except ValueError as error:
            say(f"tdgbench verify: {error}", stderr=True)
            return 1
        for problem in problems:
            say(problem, "problem:")
        say(f"{experiment}: {count} cells, {len(problems)} problems")
        status |= bool(problems)
    return status
