"""Run one cell: load, prior, init, train, render, score; write its folder whole, or a record of the failure."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench import output
from tdgbench.bench.environment import code_version, describe_environment, same_bytes_on
from tdgbench.bench.gpu import a_gpu_of_its_own, visible_gpus
from tdgbench.bench.init import InitialPoints
from tdgbench.bench.key import cell_key, relevant_config, why_differs
from tdgbench.bench.lock import cell_lock
from tdgbench.bench.memory import PeakMemory
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Failure, Record, read_record
from tdgbench.bench.setup import loader_of
from tdgbench.priors import DepthPrior, PriorError, estimate_all
from tdgbench.scenes import Dataset, MissingScenesError, Scene, SceneError, View
from tdgbench.scoring import Scorer, mean_scores
from tdgbench.splats.cpu import pool
from tdgbench.splats.ply import save_ply
from tdgbench.splats.rasterization import choose_backend
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.errors import TrainingError
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Context, Method, training_device
from tdgbench.training.skips import Skips
from tdgbench.training.skips.account import note_training
from tdgbench.training.skips.plateau import Plateau
from tdgbench.training.warmup import compile_kernels

OVERWRITE = ("only-missing", "always", "never")
Status = Literal["ok", "kept", "failed", "missing", "elsewhere"]
FAILURES_OF_THE_INPUT = (SceneError, PriorError, TrainingError)


@dataclass(frozen=True)
class Outcome:
    """What became of a cell: run (`ok`), already there (`kept`), `failed`, its scene not on disk (`missing`), or
    in the hands of another process (`elsewhere`)."""

    status: Status
    title: str
    message: str = ""


def run_cell(cfg: DictConfig, variant: str, progress: CellProgress) -> Outcome:
    """Run the cell that a resolved configuration describes. Never raises for a cell's own failure."""
    if cfg.overwrite not in OVERWRITE:
        raise ValueError(f"overwrite is {cfg.overwrite!r}; it must be one of {', '.join(OVERWRITE)}")
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)  # the kernels have their own pool; idle OpenMP workers only cost time
    record = Record(
        method=cfg.method.name,
        dataset="",
        scene=str(cfg.scene),
        init=cfg.init.name,
        seed=int(cfg.seed),
        experiment=cfg.name,
        variant=variant,
        environment=describe_environment(),
    )
    experiment = Path(cfg.results) / cfg.name
    stages, held = _Stages(record, progress), ExitStack()
    progress.begin(record.title)
    try:
        with stages("load"):
            skips: Skips = instantiate(cfg.skip)
            dataset: Dataset = instantiate(loader_of(cfg, skips))
            what = dataset.describe(cfg.scene)
            record.scene, record.dataset, record.group = what.scene, what.dataset, what.group
            progress.rename(record.title)
            scene = dataset.load(cfg.scene)
            method: Method = instantiate(cfg.method.method)
            record.config = relevant_config(cfg, method)
            record.data, record.code = scene.fingerprint, code_version()
            record.key = cell_key(record)
        folder = cell_folder_of(experiment, record)
        if not held.enter_context(cell_lock(experiment, folder)):
            return Outcome("elsewhere", record.title, "another process is running it")
        existing = _existing(folder)
        known = None if existing is None else _known(existing, record, cfg)
        if known is not None:
            return known
        if training_device(cfg.backend.name).type == "cuda":
            torch.cuda.set_device(held.enter_context(a_gpu_of_its_own(visible_gpus())))
            record.environment = describe_environment()
        checkpoint = _checkpoint_of(cfg, record, experiment, folder)
        with PeakMemory() as memory:
            scorer, log = _train(cfg, record, scene, method, skips, stages, checkpoint)
        record.peak_rss_mb, record.peak_gpu_mb = memory.mb, memory.gpu_mb
        _write_results(record, scene, method, scorer, log, folder, stages)
        checkpoint.discard()
        why = "" if existing is None else "; ".join(why_differs(existing, record))
        return Outcome("ok", record.title, f"made anew: {why}" if why else "")
    except MissingScenesError as error:
        return Outcome("missing", record.title, str(error))
    except Exception as error:
        message = str(error) if isinstance(error, FAILURES_OF_THE_INPUT) else f"{type(error).__name__}: {error}"
        record.status = "failed"
        record.failure = Failure(
            stage=stages.current,
            error=f"{type(error).__name__}: {error}",
            traceback=traceback.format_exc(),
            iteration=getattr(error, "iteration", None) if isinstance(error, TrainingError) else None,
            tensor=getattr(error, "tensor", None) if isinstance(error, TrainingError) else None,
        )
        try:
            _write_failure(cell_folder_of(experiment, record), record)
        except OSError as unwritten:
            message += f" (and its record could not be written: {unwritten})"
        return Outcome("failed", record.title, f"{stages.current}: {message}")
    finally:
        held.close()
        progress.end()


def _known(existing: Record, record: Record, cfg: DictConfig) -> Outcome | None:
    """What is to be said of a cell that need not be run; None if it must be."""
    if existing.status == "failed":
        if existing.failure is None or existing.key != record.key or cfg.overwrite == "always" or cfg.retry_failed:
            return None
        again = "as before, not tried again (retry_failed=true does)"
        return Outcome("failed", record.title, f"{existing.failure.stage}: {existing.failure.error}, {again}")
    if cfg.overwrite == "always":
        return None
    if existing.key == record.key:
        return Outcome("kept", record.title)
    if cfg.overwrite == "never":
        why = "; ".join(why_differs(existing, record))
        return Outcome("kept", record.title, f"made with other settings ({why}); overwrite=never keeps it")
    return None


def cell_folder_of(experiment: Path, record: Record) -> Path:
    """<experiment>/cells/<method>/<dataset>/<scene>/<init>/seed<k>[,<other overrides>]."""
    last = f"seed{record.seed}" + (f",{record.variant}" if record.variant else "")
    parts = [record.method, record.dataset or "unknown", record.scene, record.init, last]
    safe = ["".join(c if c.isalnum() or c in "-_.,=+" else "_" for c in part) for part in parts]
    return experiment / "cells" / Path(*safe)


def _checkpoint_of(cfg: DictConfig, record: Record, experiment: Path, folder: Path) -> Checkpoint:
    """Where this cell's training is kept while it runs."""
    path = experiment / "checkpoints" / f"{output.short_name(experiment, folder)}.pt"
    checkpoint = Checkpoint(path, {"settings, data or code": record.key, **same_bytes_on()}, cfg.checkpoint)
    if cfg.overwrite == "always":
        checkpoint.discard()
    return checkpoint


def _rgb_views(skips: Skips, method: Method, scene: Scene) -> list[View]:
    """The training views whose RGB images are read: those that the method needs, or without the skip all there are."""
    if method.needs_rgb:
        return scene.train
    there = [view for view in scene.train if view.load_rgb is not None]
    needless = f"{method.name} trains on thermal images alone"
    return [] if skips.rgb.decide(bool(there), needless, f"{len(there)} images") else there


def _note_prior(skips: Skips, scene: Scene, made: int) -> None:
    there = len(scene.train) - made
    reason = f"{there} of {len(scene.train)} training views were estimated before; test views need no prior"
    skips.prior.decide(there > 0, reason, f"{there} estimates")


class _Stages:
    """Times the stages of a cell into its record."""

    def __init__(self, record: Record, progress: CellProgress) -> None:
        self.record, self.progress, self.current = record, progress, "load"

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self.current = name
        self.progress.stage(name)
        start = time.perf_counter()
        yield
        self.record.seconds[name] = round(time.perf_counter() - start, 3)


def _train(
    cfg: DictConfig,
    record: Record,
    scene: Scene,
    method: Method,
    skips: Skips,
    stages: _Stages,
    checkpoint: Checkpoint,
) -> tuple[Scorer, TrainingLog]:
    """Everything up to the trained method; what it is scored with, and how training went."""
    budget = instantiate(cfg.budget)
    scorer: Scorer = instantiate(cfg.metrics)
    record.split, record.channels, record.notes = scene.split, scene.channels, list(scene.notes)
    span = scene.temperature
    record.temperature = None if span is None or scene.channels != 1 else [span.min, span.max]
    record.convention, record.iterations = scorer.convention, budget.iterations
    record.views = {"train": len(scene.train), "test": len(scene.test)}
    record.backend = choose_backend(cfg.backend.name, training_device(cfg.backend.name), torch.float32)
    with stages("images"):  # all of them, so that training does not pay for it and a broken one stops the cell now
        for view in scene.views:
            _ = view.thermal
        for view in _rgb_views(skips, method, scene):
            _ = view.rgb
    priors: dict[str, DepthPrior] = {}
    if method.needs_prior:
        with stages("prior"):
            estimator = instantiate(cfg.prior.estimator)
            cache = Path(cfg.results) / "cache" / "priors" if skips.prior.allowed else None
            priors, made = estimate_all(estimator, scene, cache, stages.progress.count)
            _note_prior(skips, scene, made)
            record.prior = {**estimator.identity(), "kind": next(iter(priors.values())).kind}
    with stages("init"):
        init: InitialPoints = instantiate(cfg.init.points)
        context = Context(scene, init.points(scene), priors, budget, cfg.backend.name, int(cfg.seed), skips)
        record.init_points = init.describe(scene)
        method.setup(context)
    with stages("compile"):
        compile_kernels({scene.channels, *([3] if method.needs_rgb else [])}, budget, cfg.backend.name)
    with stages("train"):
        watched = budget.plateau is not None and skips.plateau.allowed
        plateau = Plateau(budget.plateau, len(scene.train)) if watched else None
        so_far = checkpoint.take_up(method, context, plateau)
        try:
            log = train(method, budget.iterations, stages.progress.line, plateau, checkpoint.after_step, so_far)
        except TrainingError:
            checkpoint.discard()  # it would end there again
            raise
    record.resumed = log.resumed
    record.notes += checkpoint.notes
    record.seconds["train"], record.iterations = round(log.seconds, 3), log.iterations
    note_training(skips, scene, method, budget, log)
    record.skips = [asdict(skip) for skip in skips.all()]
    record.gaussians = {name: len(model) for name, model in method.models().items()}
    return scorer, log


def _write_results(
    record: Record, scene: Scene, method: Method, scorer: Scorer, log: TrainingLog, folder: Path, stages: _Stages
) -> None:
    """Render and score the test views; write the cell's folder whole or not at all."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with output.whole_folder(folder) as part:
        with stages("render"):
            renders = output.write_renders(method, scene.test, part)
        with stages("score"):
            scores = {
                view.name: scorer.score(scene, view, image, depth)
                for view, (image, depth) in zip(scene.test, renders, strict=True)
            }
        with stages("score_train"):
            record.train_scores = output.score_training_views(method, scene, scorer)
        record.scores, record.missing = mean_scores(scores), dict(scorer.missing)
        with stages("write"):
            for name, model in method.models().items():
                save_ply(model.gaussians, part / ("model.ply" if name == "thermal" else f"model_{name}.ply"))
            output.write_cameras(part / "cameras.json", scene)
            output.write_views(part / "views.csv", scores)
            output.write_log(part / "log.csv", log)
        record.hashes = output.hashes(part)
        record.write(part)


def _existing(folder: Path) -> Record | None:
    """The record that is there; a broken one counts as none (it will be made anew)."""
    try:
        return read_record(folder)
    except ValueError:
        return None


def _write_failure(folder: Path, record: Record) -> None:
    """Put the failure in the cell's place; a finished result of other settings is kept beside it, hidden."""
    existing = _existing(folder)
    if existing is not None and existing.status == "ok":
        folder.replace(folder.with_name(f".{folder.name}-{existing.key[:8]}"))
    folder.mkdir(parents=True, exist_ok=True)
    record.write(folder)
