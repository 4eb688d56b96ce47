"""`python -m tdgbench.verify results/<experiment> …`: are results what their records say?

For every finished cell: the record fits its schema; files have the hashes that it names; the model, rendered again from
the test cameras, gives the stored pictures; and the pictures give the stored scores.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
from PIL import Image
from rich.console import Console
from rich.markup import escape

from tdgbench.bench.output import hashes, read_cameras, render_model
from tdgbench.bench.record import FILE
from tdgbench.scenes import Camera
from tdgbench.scoring import METRICS, LPIPSOptions, Scorer, to_8bit
from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.scored_view import ImagePair, Modality, NotApplicableError
from tdgbench.splats.ply import load_ply

SCHEMA = Path(__file__).parent / "bench" / "record.schema.json"
MOST_OFF = 1e-3  # share of values that may differ by one of 255 levels: another processor rounds otherwise
SCORE_TOLERANCE = 1e-6


def verify(experiment: Path) -> tuple[int, list[str]]:
    """How many cells were looked at, and every problem in words. Raises ValueError if there are none."""
    folders = [
        path.parent
        for path in sorted((experiment / "cells").rglob(FILE))
        if not any(part.startswith(".") for part in path.relative_to(experiment).parts)
    ]
    if not folders:
        raise ValueError(f"{experiment} holds no records; run an experiment first")
    problems = []
    for folder in folders:
        problems += [f"{folder.relative_to(experiment / 'cells')}: {problem}" for problem in verify_cell(folder)]
    return len(folders), problems


def verify_cell(folder: Path) -> list[str]:
    """What is wrong with one cell; failed cells are only held against the schema."""
    try:
        content = json.loads((folder / FILE).read_text())
    except ValueError as error:
        return [f"{FILE} is not JSON: {error}"]
    wrong = [f"{FILE}: {error.json_path}: {error.message}" for error in _schema().iter_errors(content)]
    if wrong or content["status"] != "ok":
        return wrong
    return [*_files(folder, content), *_renders(folder), *_scores(folder, content)]


@cache
def _schema() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text()))


def _files(folder: Path, content: dict[str, Any]) -> Iterator[str]:
    """Files that changed, went missing, or came from nowhere."""
    there, said = hashes(folder), content["hashes"]
    yield from (f"{name} is missing" for name in sorted(set(said) - set(there)))
    yield from (f"{name} is not in the record" for name in sorted(set(there) - set(said)))
    yield from (f"{name} has changed" for name in sorted(set(there) & set(said)) if there[name] != said[name])


def _renders(folder: Path) -> Iterator[str]:
    """Pictures that the models do not give."""
    try:
        cameras = read_cameras(folder / "cameras.json", "test")
        for model, renders in (("model.ply", "renders"), ("model_rgb.ply", "renders_rgb")):
            if model == "model.ply" or (folder / renders).exists():
                yield from _renders_of(folder, model, renders, cameras)
    except (OSError, ValueError) as error:
        yield f"cannot be rendered again: {error}"


def _renders_of(folder: Path, model: str, renders: str, cameras: dict[str, Camera]) -> Iterator[str]:
    gaussians = load_ply(folder / model)
    for name, camera in cameras.items():
        path = folder / renders / f"{name}.png"
        if not path.exists():
            continue  # told as missing
        stored, again = _picture(path), to_8bit(render_model(gaussians, camera).image.numpy())
        if stored.shape != again.shape:
            yield f"{renders}/{name}.png is {stored.shape}, the model gives {again.shape}"
            continue
        off = np.abs(stored.astype(int) - again.astype(int))
        if off.max() > 1 or (off > 0).mean() > MOST_OFF:
            share = f"{(off > 0).mean():.1%} differ, by up to {off.max()}"
            yield f"{renders}/{name}.png is not what {model} gives: {share}"


def _picture(path: Path) -> np.ndarray:
    """(H, W, C) uint8."""
    values = np.asarray(Image.open(path))
    return values[..., None] if values.ndim == 2 else values


def _scores(folder: Path, content: dict[str, Any]) -> Iterator[str]:
    """Scores that the stored pictures do not give. Those that need more than pictures are not computed again."""
    with (folder / "views.csv").open(newline="") as file:
        rows = {row["view"]: row for row in csv.DictReader(file)}
    metrics = content["config"]["metrics"]
    options = LPIPSOptions(metrics["lpips"]["net"], metrics["lpips"]["weights"], download=False)
    scorer = Scorer(metrics["convention"], metrics["ssim_border"], metrics["lpips_range"], options)
    found: dict[str, list[float]] = {}
    for name, row in rows.items():
        for metric, value in _scores_of(folder, name, row, scorer).items():
            found.setdefault(metric, []).append(value)
            if not _is_close(value, float(row[metric])):
                yield f"views.csv: {metric} of {name} is {row[metric]}, its pictures give {value:.6f}"
    for metric, values in found.items():
        said = content["scores"].get(metric)
        if len(values) == len(rows) and (said is None or not _is_close(float(np.mean(values)), said)):
            yield f"{FILE}: {metric} is {said}, the pictures give {np.mean(values):.6f}"


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


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tdgbench.verify", description=__doc__)
    parser.add_argument("experiment", nargs="+", type=Path, help="a folder results/<experiment>")
    console, status = Console(), 0
    for experiment in parser.parse_args().experiment:
        try:
            count, problems = verify(experiment)
        except ValueError as error:
            print(f"tdgbench.verify: {error}", file=sys.stderr)
            return 1
        for problem in problems:
            console.print(f"[red]wrong:[/red] {escape(problem)}", highlight=False, soft_wrap=True)
        console.print(f"{experiment}: {count} cells, {len(problems)} problems", highlight=False, soft_wrap=True)
        status |= bool(problems)
    return status


if __name__ == "__main__":
    sys.exit(main())
