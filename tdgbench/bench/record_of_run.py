"""What a run puts into its cell's record: of the scene and how its files were read, and of the training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import cast

from tdgbench.bench.backend_check.choose import auto
from tdgbench.bench.setup import Training
from tdgbench.cells.ground_truth import masked_share
from tdgbench.cells.record import (
    MOST_ASSUMED,
    MOST_DOUBTS,
    MOST_SHOWN,
    MOST_STATED,
    VALUES,
    PartReport,
    Record,
    SkipRecord,
)
from tdgbench.scenes import Scene
from tdgbench.scenes.images import in_pseudo_colour
from tdgbench.scenes.scene import PALETTE
from tdgbench.scoring import Scorer
from tdgbench.text import shortened
from tdgbench.training.budget import account
from tdgbench.training.loop import TrainingLog
from tdgbench.training.skips import NO_GAUSSIANS, Finished, Skips
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer

GRAY = "gray, in three equal channels"


def describe_scene(record: Record, scene: Scene, scorer: Scorer, backend: str) -> None:
    """Put facts about the scene, its metrics and its backend into the record. backend: as it was asked for."""
    record.split, record.convention, record.notes = scene.split, scorer.convention, list(scene.notes)
    state_assumptions(record, scene)
    record.channels = scene.channels  # type: ignore[assignment]
    record.views = {"train": len(scene.train), "test": len(scene.test)}
    if backend == "auto" and auto().line:
        record.notes.append(f"backend: {auto().line}")


def describe_training(record: Record, ready: Training, log: TrainingLog, skips: Skips, notes: Sequence[str]) -> None:
    """Put facts about the finished training into the record. notes: of its checkpoint."""
    trainer, scene = ready.trainer, ready.scored
    record.masked = {"train": masked_share(scene.train), "test": masked_share(scene.test)}
    state_values(record, scene)
    record.resumed = log.resumed
    record.notes += [*notes, *trainer.method.notes]
    record.parts = cast(dict[str, PartReport], trainer.reports())
    if record.made_elsewhere is not None:
        record.seconds.pop("train")
        lacking = ["train_hours"] if record.gaussians else ["train_hours", "gaussians"]
        record.missing = dict.fromkeys(lacking, record.made_elsewhere["summary"])
        return
    if not record.gaussians:
        record.missing["gaussians"] = NO_GAUSSIANS
    record.seconds["train"], record.iterations = round(log.seconds, 3), log.iterations
    record.train_processor_seconds = round(log.processor_seconds, 3)
    accounts = account(trainer.whole_context.budget, skips, finished(trainer, log, scene))
    record.skips = [cast(SkipRecord, asdict(skip)) for skip in accounts]


def finished(trainer: Trainer, log: TrainingLog, scene: Scene) -> Finished:
    """Return what the account of skips reads of a training that is over."""
    method = trainer.method
    return Finished(
        scene=scene,
        trains_on_rgb="rgb" in method.modalities,
        planned=trainer.whole_context.budget.iterations,
        iterations=log.iterations,
        curricula=[(one, it.budget.iterations) for it in trainer.contexts for one in it.curricula.values()],
        work=[part.work for part in trainer.all_parts().values() if isinstance(part, SplatModel)],
        reached_plateau=trainer.reached_plateau,
        has_depth_loss=any("depth" in line.terms for line in log.lines),
        keeps_full_resolution=method.keeps_full_resolution,
    )


def state_assumptions(record: Record, scene: Scene) -> None:
    """Put what a scene assumes and doubts into its record, each in a line that a record can hold, without its folder.

    What does not fit is counted.
    """
    lines = {shortened(name, MOST_SHOWN): _line(text, scene.folder) for name, text in scene.assumed.items()}
    if len(lines) > MOST_ASSUMED:
        raise ValueError(f"{scene.name}: a scene assumes {MOST_ASSUMED} things at most, not {len(lines)}")
    record.assumed = lines
    state_doubts(record, scene.doubts, scene.folder)


def state_doubts(record: Record, doubts: Sequence[str], folder: Path | None) -> None:
    """Put doubts into the record, each in a line without the scene's folder; what does not fit is counted."""
    lines, more = [_line(doubt, folder) for doubt in doubts], len(doubts) - MOST_DOUBTS
    record.doubts = lines if more <= 0 else [*lines[: MOST_DOUBTS - 1], f"{more + 1} more: see tdgbench data check"]


def state_values(record: Record, scene: Scene) -> None:
    """State what images of three channels show, by the test views, for a scene that does not say it."""
    if scene.channels == 3 and VALUES not in record.assumed:
        record.assumed[VALUES] = PALETTE if in_pseudo_colour(scene.test) else GRAY


def _line(text: str, folder: Path | None) -> str:
    """Return one line, without an absolute path of the scene's folder, which says whose machine it was read on."""
    if folder is not None and folder.is_absolute() and len(folder.parts) > 1:
        text = text.replace(f"{folder}/", "").replace(str(folder), folder.name)
    return shortened(text, MOST_STATED)
