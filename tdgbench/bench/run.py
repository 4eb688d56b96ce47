"""The work of a cell, stage by stage, from loading its scene to writing its folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryFile
from typing import cast

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench import cameras
from tdgbench.bench.backend_check.choose import auto, training_backend
from tdgbench.bench.environment import code_version, same_bytes_on
from tdgbench.bench.key import cell_key, relevant_config
from tdgbench.bench.masks import masked_share
from tdgbench.bench.paths import cell_folder_of, files_of, short_name
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import PartReport, Record, SkipRecord
from tdgbench.bench.renders import render_views, write_renders
from tdgbench.bench.scores import score_training_views, write_views
from tdgbench.bench.setup import Facts, SetupObserver, loader_of, set_up
from tdgbench.bench.stored import hashes
from tdgbench.bench.stored_parts import write_parts
from tdgbench.bench.training_log import TensorBoardLog, write_log
from tdgbench.files import whole_folder
from tdgbench.scenes import Dataset, Scene
from tdgbench.scenes.datasets import Outline, outline_of
from tdgbench.scoring import Scorer, mean_scores, to_8bit
from tdgbench.splats.ply import save_ply
from tdgbench.thermal import ImageResponse
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.context import training_device
from tdgbench.training.loop import LogLine, TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.model import SplatModel
from tdgbench.training.part import TrainingError
from tdgbench.training.skips import Finished, Skips, account
from tdgbench.training.trainer import Trainer
from tdgbench.training.trial import RigTrial


class CellRun(SetupObserver):
    """One run of a cell: `identify`, then `load`, `train` and `write`. Each of them fills in the record."""

    scene: Scene
    method: Method
    _outline: Outline
    skips: Skips
    scorer: Scorer
    log: TrainingLog
    checkpoint: Checkpoint
    trainer: Trainer
    response: ImageResponse  # of the thermal camera, for renders

    def __init__(self, cfg: DictConfig, record: Record, experiment: Path, progress: CellProgress) -> None:
        self.cfg, self.record, self.experiment, self.progress = cfg, record, experiment, progress
        self.current = "options"  # name of the current stage
        self.is_locked = False  # whether this run holds the cell's lock
        self.remarks: list[str] = []  # what did not work, but changes no result
        self._board: TensorBoardLog | None = None

    @property
    def folder(self) -> Path:
        """Folder of the cell's files; final after `locate`."""
        return cell_folder_of(self.experiment, self.record)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, which the terminal and a failure name."""
        self.current = name
        self.progress.stage(name)
        start = time.perf_counter()
        yield
        self.record.seconds[name] = round(self.record.seconds.get(name, 0.0) + time.perf_counter() - start, 3)

    def count(self, done: int, total: int) -> None:
        self.progress.count(done, total)

    def note_camera(self, facts: Facts, notes: list[str]) -> None:
        self.record.camera["estimated"] = facts
        self.record.notes += notes

    def note_rig(self, trial: RigTrial) -> None:
        self.record.camera["rig"] = asdict(trial)
        self.record.notes.append(f"camera: the rig is {'learnt' if trial.pays else 'not learnt'}: {trial.reason}")

    def note_prior(self, description: dict[str, object]) -> None:
        self.record.prior = description

    def note_points(self, description: dict[str, object]) -> None:
        self.record.init_points = description

    def locate(self) -> Dataset:
        """Find out which scene of which data set the cell is about, without reading it."""
        record = self.record
        self.skips = instantiate(self.cfg.skip)
        dataset: Dataset = instantiate(loader_of(self.cfg, self.skips))
        place = dataset.describe(self.cfg.scene)
        record.scene, record.dataset, record.group = place.scene, place.dataset, place.group
        self.progress.rename(record.title)
        return dataset

    def identify(self) -> None:
        """Compute the cell's key, for which no image is decoded, and make the method."""
        cfg, record = self.cfg, self.record
        with self.stage("load"):
            self._outline = outline_of(self.locate(), cfg.scene)
            self.method = instantiate(cfg.method.method)
            record.config = relevant_config(cfg, self.method)
            record.data, record.code = self._fingerprint(), code_version()
            record.key = cell_key(record)

    def load(self) -> None:
        """Load the scene. While that fails, the cell has no key, so that the next run tries again."""
        key, self.record.key = self.record.key, ""
        with self.stage("load"):
            self.scene = self._outline.read()
        self.record.key = key

    def train(self) -> None:
        """Set the method up and train it."""
        self.progress.start(len(self.scene.train))
        self.scorer = instantiate(self.cfg.metrics)
        self.record.backend = training_backend(self.cfg.backend.name)
        self.scorer.device = training_device(self.record.backend)
        self._describe_scene()
        priors = self._cache("priors", "depth priors were")
        training = set_up(self.cfg, self.scene, method=self.method, skips=self.skips, prior_cache=priors, observer=self)
        self.trainer, self.scene, self.response = training
        self._describe_images()
        with self.stage("train"):
            self._train()
        self._describe_training()

    def _train(self) -> None:
        """Train from the last checkpoint, if there is one, to the end."""
        self.checkpoint = self._open_checkpoint()
        log = self.checkpoint.resume(self.trainer)
        on_line = self._log_listener(log.iterations)
        try:
            self.log = train(self.trainer, on_line, self.checkpoint.write_if_due, log)
        except TrainingError:
            self._discard(self.checkpoint)  # training from it would end at the same iteration
            raise

    def write(self) -> None:
        """Render and score the views; write the cell's folder whole or not at all."""
        record, scene, trainer, scorer = self.record, self.scene, self.trainer, self.scorer
        with whole_folder(self.folder) as part:
            with self.stage("render"):
                renders = render_views(trainer, scene.test, self.response)
                write_renders(renders, scene.test, part)
            with self.stage("score"):
                scores = scorer.score(scene, renders)
            with self.stage("score_train"):
                record.train_scores = score_training_views(trainer, scene, scorer, self.response)
            record.scores, record.missing = mean_scores(scores), dict(scorer.missing)
            with self.stage("write"):
                for name, model in trainer.gaussians.items():
                    save_ply(model.gaussians, part / files_of(name).model)
                write_parts(trainer, part)
                cameras.write_cameras(part / cameras.FILE, scene)
                write_views(part / "views.csv", scores)
                write_log(part / "log.csv", self.log)
            record.hashes = hashes(part)
            record.write(part)
        self._discard(self.checkpoint)
        if self._board is not None:
            with self._remarked("scores and renders could not be written to the TensorBoard log"):
                images = {name: to_8bit(view.image) for name, view in renders.items()}
                self._board.results(record.iterations, record.scores, images)

    def discard_checkpoint(self) -> None:
        """Remove the cell's checkpoint, if there is one."""
        self._discard(Checkpoint(self._checkpoint_path, {}, None))

    def close(self) -> None:
        """Close the TensorBoard log, if there is one."""
        if self._board is not None:
            self._board.close()

    def _discard(self, checkpoint: Checkpoint) -> None:
        with self._remarked("its checkpoint could not be removed"):
            checkpoint.discard()

    @contextmanager
    def _remarked(self, what: str) -> Iterator[None]:
        """Turn an error in work beside the result into a remark on the outcome."""
        try:
            yield
        except Exception as error:
            self.remarks.append(f"{what}: {error}")

    def _cache(self, name: str, what: str) -> Path | None:
        """Return the folder of what cells of a scene share; None, with a remark, if it cannot be written."""
        folder = Path(self.cfg.results) / "cache" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=folder):
                return folder
        except OSError as error:
            self.remarks.append(f"{what} not cached: {error}")
            return None

    def _fingerprint(self) -> str:
        """Return the fingerprint of the scene's files, and of those that its prior is read from."""
        scene, needs_prior = self._outline.scene, self.method.needs_prior
        files = instantiate(self.cfg.prior.estimator).identity(scene).get("files") if needs_prior else None
        return scene.fingerprint if files is None else f"{scene.fingerprint}-{files}"

    def _describe_scene(self) -> None:
        """Put facts about the scene, its metrics and its backend into the record."""
        record, scene = self.record, self.scene
        record.split, record.channels, record.notes = scene.split, scene.channels, list(scene.notes)
        record.convention = self.scorer.convention
        record.views = {"train": len(scene.train), "test": len(scene.test)}
        if self.cfg.backend.name == "auto" and auto().line:
            record.notes.append(f"backend: {auto().line}")

    def _describe_images(self) -> None:
        """Put what is known of the images that are trained on and scored into the record."""
        span, contrast = self.scene.temperature, self.cfg.contrast.training
        self.record.temperature = None if span is None or self.scene.channels != 1 else [span.min, span.max]
        if contrast != "none":
            self.record.notes.append(f"contrast: images are trained on and scored with contrast.training={contrast}")

    def _describe_training(self) -> None:
        """Put facts about the finished training into the record."""
        record, trainer, log = self.record, self.trainer, self.log
        record.masked = {"train": masked_share(self.scene.train), "test": masked_share(self.scene.test)}
        record.resumed = log.resumed
        record.notes += self.checkpoint.notes
        record.seconds["train"], record.iterations = round(log.seconds, 3), log.iterations
        record.train_processor_seconds = round(log.processor_seconds, 3)
        work = [part.work for part in trainer.all_parts().values() if isinstance(part, SplatModel)]
        curricula = [(context.curriculum, context.budget.iterations) for context in trainer.contexts]
        budget, on_rgb = trainer.whole_context.budget, "rgb" in self.method.modalities
        finished = Finished(self.scene, self.method.name, on_rgb, budget, log.iterations, curricula, work)
        record.skips = [cast(SkipRecord, asdict(skip)) for skip in account(self.skips, finished)]
        record.parts = cast(dict[str, PartReport], trainer.reports())

    @property
    def _checkpoint_path(self) -> Path:
        return self.experiment / "checkpoints" / f"{short_name(self.experiment, self.folder)}.pt"

    def _open_checkpoint(self) -> Checkpoint:
        """Return the checkpoint of this cell; with overwrite=always a stored one is removed."""
        made_with = {
            "settings, data or code": self.record.key,
            "backend": self.record.backend,
            **same_bytes_on(self.record.environment),
        }
        checkpoint = Checkpoint(self._checkpoint_path, made_with, self.cfg.checkpoint)
        if self.cfg.overwrite == "always":
            self._discard(checkpoint)
        return checkpoint

    def _log_listener(self, after: int) -> Callable[[LogLine], None]:
        """Return the callback for training log lines, from the iteration after `after` on."""
        if self.cfg.log.writer is None:
            return self.progress.line
        place = self.folder.relative_to(self.experiment / "cells")
        board: TensorBoardLog = instantiate(self.cfg.log.writer)(self.experiment / "tensorboard" / place, after)
        self._board = board

        def listen(line: LogLine) -> None:
            self.progress.line(line)
            board.line(line)

        return listen
