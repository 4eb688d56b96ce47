"""The work of a cell, phase by phase, from loading its scene to writing its folder."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple, cast

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.backend_check.choose import training_backend
from tdgbench.bench.environment import SAME_BYTES, code_version
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record_of_run import describe_scene, describe_training, state_doubts
from tdgbench.bench.scores import render_views, score_training_views, write_renders
from tdgbench.bench.setup import SetupObserver, Training, loader_of, set_up
from tdgbench.cells.cameras import write_cameras
from tdgbench.cells.cell_tables import write_log, write_views
from tdgbench.cells.folder import hashes_below
from tdgbench.cells.ground_truth import truth_hashes
from tdgbench.cells.key import as_json, cell_key, relevant_config
from tdgbench.cells.paths import CHECKPOINTS, RUNNING, cell_folder_of, files_of, prior_cache, short_name
from tdgbench.cells.protocol import protocol_of
from tdgbench.cells.read_files import MOST_PIXELS
from tdgbench.cells.record import MadeElsewhere, PartReport, Record
from tdgbench.cells.renders import write_parts
from tdgbench.files import whole_folder
from tdgbench.scenes import Dataset, Scene, SceneError
from tdgbench.scenes.datasets import Outline, outline_of
from tdgbench.scenes.images import degC_of_values
from tdgbench.scoring import Scorer, mean_scores
from tdgbench.scoring.scorer import MetricFault
from tdgbench.splats.ply import save_ply
from tdgbench.text import duration
from tdgbench.thermal import ImageResponse
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.context import training_device
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.part import TrainingError
from tdgbench.training.skips import Skips
from tdgbench.training.trainer import Trainer

ABANDONED = 86400.0  # seconds after which nobody goes on to write a file
SLOW = 1800  # seconds of networks in a training, of which the terminal warns


class IdentifiedCell(NamedTuple):
    """Scene, method and skips of a cell, before any image is decoded."""

    outline: Outline
    method: Method
    skips: Skips


class TrainedCell(NamedTuple):
    """A finished training. scene: as it is scored. response: of the thermal camera, for renders."""

    trainer: Trainer
    scene: Scene
    response: ImageResponse
    log: TrainingLog
    scorer: Scorer


class CellRun(SetupObserver):
    """One run of a cell: `identify`, `load`, `train`, `write` fill in the record, each from the phase before."""

    def __init__(self, cfg: DictConfig, record: Record, experiment: Path, progress: CellProgress) -> None:
        self.cfg, self.record, self.experiment, self.progress = cfg, record, experiment, progress
        self.current = "options"  # name of the current phase
        self.existing: Record | None = None  # in the cell's folder before this run, once it is locked
        self.is_locked = False  # whether this run holds the cell's lock
        self.remarks: list[str] = []  # what did not work, but changes no result

    @property
    def folder(self) -> Path:
        """Folder of the cell's files; final after `locate`."""
        return cell_folder_of(self.experiment, self.record)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Time a phase, which the terminal and a failure name."""
        self.current = name
        self.progress.phase(name)
        start = time.perf_counter()
        yield
        self.record.seconds[name] = round(self.record.seconds.get(name, 0.0) + time.perf_counter() - start, 3)

    def count(self, done: int, total: int) -> None:
        self.progress.count(done, total)

    def note(self, field: str, facts: dict[str, Any], notes: Sequence[str] = ()) -> None:
        setattr(self.record, field, {**(getattr(self.record, field) or {}), **facts})
        self.record.notes += notes
        for note in notes:
            self.progress.say(note)

    def doubt(self, doubts: Sequence[str], folder: Path | None = None) -> None:
        state_doubts(self.record, [*doubts, *self.record.doubts], folder)
        self.record.has_doubts_of_its_own |= bool(doubts)

    def locate(self) -> tuple[Dataset, Skips]:
        """Return the cell's data set and skips; put the names of its scene into the record, without reading it."""
        record = self.record
        skips: Skips = instantiate(self.cfg.skip)
        dataset: Dataset = instantiate(loader_of(self.cfg, skips))
        place = dataset.describe(self.cfg.scene)
        record.scene, record.dataset, record.group = place.scene, place.dataset, place.group
        self.progress.rename(record.title)
        return dataset, skips

    def identify(self) -> IdentifiedCell:
        """Compute the cell's key, for which no image is decoded, and make the method."""
        cfg, record = self.cfg, self.record
        with self.phase("load"):
            dataset, skips = self.locate()
            cell = IdentifiedCell(outline_of(dataset, cfg.scene), instantiate(cfg.method.method), skips)
            record.config = relevant_config(cfg, cell.method)
            record.data, record.code = self._fingerprint(cell), code_version(record.config)
            record.key, record.protocol = cell_key(record), protocol_of(record.config)
        return cell

    def load(self, cell: IdentifiedCell) -> Scene:
        """Load the scene. While that fails, the cell has no key, so that the next run tries again."""
        key, self.record.key = self.record.key, ""
        with self.phase("load"):
            scene = cell.outline.read()
            width, height = max(((v.camera.width, v.camera.height) for v in scene.views), key=math.prod)
            if width * height > MOST_PIXELS:
                raise SceneError(
                    f"{scene.name} has views of {width}×{height} px, and results hold {MOST_PIXELS} px at most: "
                    f"set data.width={int(width * (MOST_PIXELS / (width * height)) ** 0.5)} or less"
                )
        self.record.key = key
        return scene

    def train(self, cell: IdentifiedCell, scene: Scene) -> TrainedCell:
        """Set the method up and train it, from the last checkpoint, if there is one, to the end."""
        if cell.method.trains:
            self.progress.start(len(scene.train), instantiate(self.cfg.budget).may_end_early)
        scorer: Scorer = instantiate(self.cfg.metrics)
        self.record.backend = training_backend(self.cfg.backend.name)
        describe_scene(self.record, scene, scorer, self.cfg.backend.name)
        priors = self._prior_cache()
        ready = set_up(self.cfg, scene, method=cell.method, skips=cell.skips, prior_cache=priors, observer=self)
        self.record.temperature_range = degC_of_values(ready.scored)
        self._warn_if_slow(ready.trainer)
        method = ready.trainer.method
        if not method.trains:
            self.doubt(method.doubts(ready.scored), scene.folder)
        for note in method.notes:
            self.progress.say(note)
        with self.phase("train"):
            checkpoint = self._open_checkpoint()
            if cell.method.trains:
                self._announce(ready)
            log = checkpoint.resume(ready.trainer)
            try:
                trainer, show = ready.trainer, self.progress.line
                log = train(trainer, lambda line: show(line, trainer.last_iteration), checkpoint.write_if_due, log)
            except TrainingError:
                self.discard_checkpoint()  # training from it would end at the same iteration
                raise
        describe_training(self.record, ready, log, cell.skips, checkpoint.notes)
        return TrainedCell(*ready, log, scorer)

    def _warn_if_slow(self, trainer: Trainer) -> None:
        """Say before a long training on the CPU how long its networks alone will take."""
        seconds = trainer.method.step_seconds()
        whole = seconds * trainer.whole_context.budget.iterations
        if whole > SLOW and training_device(self.record.backend).type == "cpu":
            self.progress.say(
                f"its networks alone will take at least {duration(whole)} on this CPU ({seconds:.2g} s a step"
                f"{', more as Gaussians grow' * bool(trainer.gaussians)}); budget.iterations=NUMBER is shorter, "
                "backend=cuda faster"
            )

    def write(self, trained: TrainedCell) -> None:
        """Render and score the views; write the cell's folder whole or not at all."""
        record = self.record
        trainer, scene, response, log, scorer = trained
        for model in trainer.gaussians.values():
            model.end()
        with whole_folder(self.folder) as unfinished:
            with self.phase("render"):
                renders = render_views(trainer, scene.test, response)
                write_renders(renders, scene.test, unfinished)
            with self.phase("score"):
                scores = scorer.score(scene, renders)
            with self.phase("score_train"):
                record.train_scores = score_training_views(trainer, scene, scorer, response)
            record.scores, record.missing = mean_scores(scores), {**record.missing, **scorer.missing}
            self.remarks += [f"{name} {why}" for name, why in scorer.missing.items() if isinstance(why, MetricFault)]
            with self.phase("write"):
                for name, model in trainer.gaussians.items():
                    save_ply(model.gaussians, unfinished / files_of(name).model)
                write_parts(trainer, unfinished)
                write_cameras(unfinished, scene)
                write_views(unfinished, scores)
                write_log(unfinished, log)
            record.hashes, record.truth = hashes_below(unfinished), truth_hashes(scene.test)
            record.write(unfinished)
        self.discard_checkpoint()

    def _announce(self, ready: Training) -> None:
        """Write what the checkpoints are of, for `tdgbench view --follow`: the record so far, and the cameras."""
        behind = {name: ready.trainer.whole_context.background(name) for name in ready.trainer.method.modalities}
        parts = {name: PartReport(background=mean.tolist()) for name, mean in behind.items() if mean is not None}
        try:
            with whole_folder(self._running) as unfinished:
                replace(self.record, seconds={"train": 0.0}, parts=parts).write(unfinished)
                write_cameras(unfinished, ready.scored)
        except OSError as error:
            self.remarks.append(f"tdgbench view --follow cannot show it: {error}")

    def withdraw(self) -> None:
        """Remove what `train` wrote for `tdgbench view --follow`."""
        shutil.rmtree(self._running, ignore_errors=True)

    def discard_checkpoint(self) -> None:
        """Remove the cell's checkpoint, if there is one."""
        try:
            Checkpoint(self._checkpoint_path, {}, None).discard()
        except OSError as error:
            self.remarks.append(f"its checkpoint could not be removed: {error}")

    def _prior_cache(self) -> Path | None:
        """Return the folder of depth priors that cells share; None, with a remark, if it cannot be written."""
        folder = prior_cache(Path(self.cfg.results))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for part in folder.glob(".*.npz"):  # of a killed process, or of one that renames it just now
                with suppress(OSError):
                    if time.time() - part.stat().st_mtime > ABANDONED:
                        part.unlink()
            with TemporaryFile(dir=folder):
                return folder
        except OSError as error:
            self.remarks.append(f"depth priors were not cached: {error}")
            return None

    def _fingerprint(self, cell: IdentifiedCell) -> str:
        """Return the fingerprint of the scene's files, and of those that its prior or its renders are read from."""
        scene, needs_prior = cell.outline.scene, cell.method.needs_prior
        if not cell.method.trains:
            self.record.made_elsewhere = cast(MadeElsewhere, as_json(cell.method.made_elsewhere(scene)))
            return f"{scene.fingerprint}-{self.record.made_elsewhere['files']}"
        files = instantiate(self.cfg.prior.estimator).identity(scene).get("files") if needs_prior else None
        return scene.fingerprint if files is None else f"{scene.fingerprint}-{files}"

    @property
    def _running(self) -> Path:
        return self.experiment / RUNNING / short_name(self.experiment, self.folder)

    @property
    def _checkpoint_path(self) -> Path:
        return self.experiment / CHECKPOINTS / f"{short_name(self.experiment, self.folder)}.pt"

    def _open_checkpoint(self) -> Checkpoint:
        """Return the checkpoint of this cell; with overwrite=always a stored one is removed."""
        made_with = {
            "settings, data or code": self.record.key,
            "backend": self.record.backend,
            **{name: self.record.environment[name] for name in SAME_BYTES},
        }
        if self.cfg.overwrite == "always":
            self.discard_checkpoint()
        return Checkpoint(self._checkpoint_path, made_with, self.cfg.checkpoint)
