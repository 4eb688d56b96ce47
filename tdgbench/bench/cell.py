"""Run a cell, unless its result is there or another process runs it; a failure becomes a record."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from omegaconf import DictConfig

from tdgbench.bench.environment import describe_environment
from tdgbench.bench.gpu import exclusive_gpu, visible_gpus
from tdgbench.bench.key import why_differs
from tdgbench.bench.lock import cell_lock
from tdgbench.bench.memory import PeakMemory
from tdgbench.bench.options import check_options
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Failure, Record, read_record
from tdgbench.bench.run import CellRun
from tdgbench.priors import PriorError
from tdgbench.scenes import MissingScenesError, SceneError
from tdgbench.splats.cpu import pool
from tdgbench.training.errors import TrainingError
from tdgbench.training.method import training_device

Status = Literal["ok", "kept", "failed", "missing", "elsewhere"]
EXPECTED_ERRORS = (SceneError, PriorError, TrainingError)  # their message says enough without its type


@dataclass(frozen=True)
class Outcome:
    """Outcome of a cell.

    status: `ok` (it ran), `kept` (its result was there), `failed`, `missing` (its scene is not on disk), or
    `elsewhere` (another process runs it).
    """

    status: Status
    title: str
    message: str = ""


def run_cell(cfg: DictConfig, variant: str, progress: CellProgress) -> Outcome:
    """Run the cell that a resolved configuration describes. A failure of the cell is an outcome, not an exception.

    Raises OptionError for a configuration that describes no cell.
    """
    check_options(cfg)
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)  # the kernels use a pool of threads; idle OpenMP workers would slow it down
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
        existing = _readable_record(run.folder)
        skipped = None if existing is None else _outcome_without_run(existing, record, cfg)
        if skipped is not None:
            return skipped
        if training_device(cfg.backend.name).type == "cuda":
            torch.cuda.set_device(held.enter_context(exclusive_gpu(visible_gpus())))
            record.environment = describe_environment()
        with PeakMemory() as memory:
            run.train()
        record.peak_rss_mb, record.peak_gpu_mb = memory.mb, memory.gpu_mb
        run.write()
        return Outcome("ok", record.title, "; ".join(_remarks(existing, record)))
    except MissingScenesError as error:
        return Outcome("missing", record.title, str(error))
    except Exception as error:
        return _failed(error, run)
    finally:
        held.close()
        progress.end()


def _remarks(existing: Record | None, record: Record) -> list[str]:
    """Why a cell with a record ran again, and where its training resumed."""
    changes = [] if existing is None else why_differs(existing, record)
    remarks = [f"run again, changed: {'; '.join(changes)}"] if changes else []
    return remarks + ([f"resumed after iteration {record.resumed[-1]}"] if record.resumed else [])


def _failed(error: Exception, run: CellRun) -> Outcome:
    """Write the record of a failure and return its outcome."""
    record, stage = run.record, run.current
    message = str(error) if isinstance(error, EXPECTED_ERRORS) else f"{type(error).__name__}: {error}"
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
        message += f" (its record could not be written: {unwritten})"
    return Outcome("failed", record.title, f"{stage}: {message}")


def _outcome_without_run(existing: Record, record: Record, cfg: DictConfig) -> Outcome | None:
    """Outcome of a cell that can be skipped, or None if it has to run."""
    if existing.status == "failed":
        if existing.failure is None or existing.key != record.key or cfg.overwrite == "always" or cfg.retry_failed:
            return None
        failure = f"{existing.failure.stage}: {existing.failure.error}"
        return Outcome("failed", record.title, f"{failure} (in an earlier run; retry_failed=true runs it again)")
    if cfg.overwrite == "always":
        return None
    if existing.key == record.key:
        return Outcome("kept", record.title)
    if cfg.overwrite == "never":
        changes = "; ".join(why_differs(existing, record))
        return Outcome("kept", record.title, f"overwrite=never keeps a result of other settings ({changes})")
    return None


def _readable_record(folder: Path) -> Record | None:
    """The record in a folder; None if there is none, or if it is broken and the cell has to run again."""
    try:
        return read_record(folder)
    except ValueError:
        return None


def _write_failure(folder: Path, record: Record) -> None:
    """Write the record of a failure to the cell's folder; hide a finished result of other settings beside it."""
    existing = _readable_record(folder)
    if existing is not None and existing.status == "ok":
        folder.replace(folder.with_name(f".{folder.name}-{existing.key[:8]}"))
    folder.mkdir(parents=True, exist_ok=True)
    record.write(folder)
