"""A cell: is it to be run, who may run it, and what becomes of it, a failure included."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from omegaconf import DictConfig

from tdgbench.bench.environment import describe_environment
from tdgbench.bench.gpu import a_gpu_of_its_own, visible_gpus
from tdgbench.bench.key import why_differs
from tdgbench.bench.lock import cell_lock
from tdgbench.bench.memory import PeakMemory
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Failure, Record, read_record
from tdgbench.bench.run import CellRun
from tdgbench.priors import PriorError
from tdgbench.scenes import MissingScenesError, SceneError
from tdgbench.splats.cpu import pool
from tdgbench.training.errors import TrainingError
from tdgbench.training.method import training_device

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
    run, held = CellRun(cfg, record, experiment, progress), ExitStack()
    held.callback(run.close)
    progress.begin(record.title)
    try:
        run.load()
        if not held.enter_context(cell_lock(experiment, run.folder)):
            return Outcome("elsewhere", record.title, "another process is running it")
        existing = _existing(run.folder)
        known = None if existing is None else _known(existing, record, cfg)
        if known is not None:
            return known
        if training_device(cfg.backend.name).type == "cuda":
            torch.cuda.set_device(held.enter_context(a_gpu_of_its_own(visible_gpus())))
            record.environment = describe_environment()
        with PeakMemory() as memory:
            run.train()
        record.peak_rss_mb, record.peak_gpu_mb = memory.mb, memory.gpu_mb
        run.write()
        why = "" if existing is None else "; ".join(why_differs(existing, record))
        said = [f"made anew: {why}"] if why else []
        said += [f"went on after iteration {record.resumed[-1]}"] if record.resumed else []
        return Outcome("ok", record.title, "; ".join(said))
    except MissingScenesError as error:
        return Outcome("missing", record.title, str(error))
    except Exception as error:
        return _failed(error, run)
    finally:
        held.close()
        progress.end()


def _failed(error: Exception, run: CellRun) -> Outcome:
    """Record a failure and say what it was."""
    record, stage = run.record, run.current
    message = str(error) if isinstance(error, FAILURES_OF_THE_INPUT) else f"{type(error).__name__}: {error}"
    record.status = "failed"
    record.failure = Failure(
        stage=stage,
        error=f"{type(error).__name__}: {error}",
        traceback=traceback.format_exc(),
        iteration=getattr(error, "iteration", None) if isinstance(error, TrainingError) else None,
        tensor=getattr(error, "tensor", None) if isinstance(error, TrainingError) else None,
    )
    try:
        _write_failure(run.folder, record)
    except OSError as unwritten:
        message += f" (and its record could not be written: {unwritten})"
    return Outcome("failed", record.title, f"{stage}: {message}")


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
