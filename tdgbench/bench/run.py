"""The work of a cell, stage by stage: load, images, prior, init, compile, train, render, score, write."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench import output
from tdgbench.bench.environment import code_version, same_bytes_on
from tdgbench.bench.init import InitialPoints
from tdgbench.bench.key import cell_key, relevant_config
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Record
from tdgbench.bench.setup import loader_of
from tdgbench.bench.tensorboard import TensorBoardLog
from tdgbench.priors import DepthPrior, estimate_all
from tdgbench.scenes import Dataset, Scene, View
from tdgbench.scoring import Scorer, mean_scores, to_8bit
from tdgbench.splats.ply import save_ply
from tdgbench.splats.rasterization import choose_backend
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.errors import TrainingError
from tdgbench.training.loop import LogLine, TrainingLog, train
from tdgbench.training.method import Context, Method, training_device
from tdgbench.training.skips import Skips
from tdgbench.training.skips.account import note_training
from tdgbench.training.skips.plateau import Plateau
from tdgbench.training.warmup import compile_kernels


class CellRun:
    """One cell on its way: `load`, then `train`, then `write`, each of which fills in the record."""

    scene: Scene
    method: Method
    skips: Skips
    scorer: Scorer
    log: TrainingLog
    checkpoint: Checkpoint

    def __init__(self, cfg: DictConfig, record: Record, experiment: Path, progress: CellProgress) -> None:
        self.cfg, self.record, self.experiment, self.progress = cfg, record, experiment, progress
        self.current = "load"  # the stage that it is in
        self._board: TensorBoardLog | None = None

    @property
    def folder(self) -> Path:
        """Where the cell's files go; known once it is loaded."""
        return output.cell_folder_of(self.experiment, self.record)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A stage: named on the terminal and in a failure, timed into the record."""
        self.current = name
        self.progress.stage(name)
        start = time.perf_counter()
        yield
        self.record.seconds[name] = round(time.perf_counter() - start, 3)

    def load(self) -> None:
        """The scene without its pictures, the method, and with them what the result depends on."""
        cfg, record = self.cfg, self.record
        with self.stage("load"):
            self.skips = instantiate(cfg.skip)
            dataset: Dataset = instantiate(loader_of(cfg, self.skips))
            what = dataset.describe(cfg.scene)
            record.scene, record.dataset, record.group = what.scene, what.dataset, what.group
            self.progress.rename(record.title)
            self.scene = dataset.load(cfg.scene)
            self.method = instantiate(cfg.method.method)
            record.config = relevant_config(cfg, self.method)
            record.data, record.code = self._fingerprint(), code_version()
            record.key = cell_key(record)

    def train(self) -> None:
        """Everything from the pictures to the trained method."""
        cfg, record, scene, method, skips = self.cfg, self.record, self.scene, self.method, self.skips
        budget = instantiate(cfg.budget)
        self.scorer = instantiate(cfg.metrics)
        self._describe()
        with self.stage("images"):  # all, so that training does not pay for it and a broken one stops the cell now
            for view in scene.views:
                _ = view.thermal
            for view in self._rgb_views():
                _ = view.rgb
        priors = self._priors() if method.needs_prior else {}
        with self.stage("init"):
            init: InitialPoints = instantiate(cfg.init.points)
            context = Context(scene, init.points(scene), priors, budget, cfg.backend.name, int(cfg.seed), skips)
            record.init_points = init.describe(scene)
            method.setup(context)
        with self.stage("compile"):
            compile_kernels({scene.channels, *([3] if method.needs_rgb else [])}, budget, cfg.backend.name)
        with self.stage("train"):
            watched = budget.plateau is not None and skips.plateau.allowed
            plateau = Plateau(budget.plateau, len(scene.train)) if watched else None
            self.checkpoint = self._checkpoint()
            so_far = self.checkpoint.take_up(method, context, plateau)
            on_line = self._listener(so_far.iterations)
            try:
                self.log = train(method, budget.iterations, on_line, plateau, self.checkpoint.after_step, so_far)
            except TrainingError:
                self.checkpoint.discard()  # it would end there again
                raise
        record.resumed = self.log.resumed
        record.notes += self.checkpoint.notes
        record.seconds["train"], record.iterations = round(self.log.seconds, 3), self.log.iterations
        note_training(skips, scene, method, budget, self.log)
        record.skips = [asdict(skip) for skip in skips.all()]
        record.gaussians = {name: len(model) for name, model in method.models().items()}
        record.density = {name: model.work.density() for name, model in method.models().items()}

    def write(self) -> None:
        """Render and score; write the cell's folder whole or not at all."""
        record, scene, method, scorer = self.record, self.scene, self.method, self.scorer
        with output.whole_folder(self.folder) as part:
            with self.stage("render"):
                renders = output.render_views(method, scene.test)
                output.write_renders(renders, scene.test, part)
            with self.stage("score"):
                scores = scorer.score(scene, renders)
            with self.stage("score_train"):
                record.train_scores = output.score_training_views(method, scene, scorer)
            record.scores, record.missing = mean_scores(scores), dict(scorer.missing)
            with self.stage("write"):
                for name, model in method.models().items():
                    save_ply(model.gaussians, part / ("model.ply" if name == "thermal" else f"model_{name}.ply"))
                output.write_cameras(part / "cameras.json", scene)
                output.write_views(part / "views.csv", scores)
                output.write_log(part / "log.csv", self.log)
                if self._board is not None:
                    images = {name: to_8bit(shown.image) for name, shown in renders.items()}
                    self._board.results(record.iterations, record.scores, images)
            record.hashes = output.hashes(part)
            record.write(part)
        self.checkpoint.discard()

    def _fingerprint(self) -> str:
        """Of the scene's files, and of those that its prior is read from."""
        if not self.method.needs_prior:
            return self.scene.fingerprint
        files = instantiate(self.cfg.prior.estimator).identity(self.scene).get("files")
        return self.scene.fingerprint if files is None else f"{self.scene.fingerprint}-{files}"

    def close(self) -> None:
        """Let go of what is open."""
        if self._board is not None:
            self._board.close()

    def _describe(self) -> None:
        """What the record says of the scene and of how it is treated."""
        record, scene, backend = self.record, self.scene, self.cfg.backend.name
        record.split, record.channels, record.notes = scene.split, scene.channels, list(scene.notes)
        span = scene.temperature
        record.temperature = None if span is None or scene.channels != 1 else [span.min, span.max]
        record.convention = self.scorer.convention
        record.views = {"train": len(scene.train), "test": len(scene.test)}
        record.backend = choose_backend(backend, training_device(backend), torch.float32)

    def _rgb_views(self) -> list[View]:
        """The views whose RGB images are read: for a method that trains on RGB all training views and what test views
        have, for its RGB scores; else none, or without the skip what training views have."""
        if self.method.needs_rgb:
            return self.scene.train + [view for view in self.scene.test if view.load_rgb is not None]
        there = [view for view in self.scene.train if view.load_rgb is not None]
        return [] if self.skips.rgb.skip_images(self.method.name, len(there)) else there

    def _priors(self) -> dict[str, DepthPrior]:
        """The training views' depth priors, from the cache where they are there."""
        skip, views = self.skips.prior, len(self.scene.train)
        with self.stage("prior"):
            estimator = instantiate(self.cfg.prior.estimator)
            cache = Path(self.cfg.results) / "cache" / "priors" if skip.allowed else None
            priors, made = estimate_all(estimator, self.scene, cache, self.progress.count)
            skip.note_cached(views - made, views)
            self.record.prior = {**estimator.identity(self.scene), "kind": next(iter(priors.values())).kind}
        return priors

    def _checkpoint(self) -> Checkpoint:
        """Where this cell's training is kept while it runs."""
        path = self.experiment / "checkpoints" / f"{output.short_name(self.experiment, self.folder)}.pt"
        made_with = {"settings, data or code": self.record.key, **same_bytes_on(self.record.environment)}
        checkpoint = Checkpoint(path, made_with, self.cfg.checkpoint)
        if self.cfg.overwrite == "always":
            checkpoint.discard()
        return checkpoint

    def _listener(self, after: int) -> Callable[[LogLine], None]:
        """Who is told how training goes, from the iteration on that it goes on from."""
        if self.cfg.log.writer is None:
            return self.progress.line
        place = self.folder.relative_to(self.experiment / "cells")
        board: TensorBoardLog = instantiate(self.cfg.log.writer)(self.experiment / "tensorboard" / place, after)
        self._board = board

        def tell(line: LogLine) -> None:
            self.progress.line(line)
            board.line(line)

        return tell
