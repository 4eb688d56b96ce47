"""Run a cell, unless its result is there or another process runs it; a failure becomes a record."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import asdict, replace
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from tdgbench.bench import failures
from tdgbench.bench.backend_check.choose import training_backend
from tdgbench.bench.cell_phases import CellRun
from tdgbench.bench.environment import describe_environment
from tdgbench.bench.machine import PeakMemory, exclusive_gpu, visible_gpus
from tdgbench.bench.options import check_names, check_options
from tdgbench.bench.progress import CellProgress, Outcome, Status, finished
from tdgbench.cells.folder import hashes_below
from tdgbench.cells.key import as_json, why_differs
from tdgbench.cells.paths import CHECKPOINTS, RECORD_FILE, hidden_folder, short_name
from tdgbench.cells.record import Failure, Record, readable_record, record_files
from tdgbench.files import file_lock, finish_replacement, put_in_place, whole_folder
from tdgbench.priors import PriorUnavailableError
from tdgbench.scenes import MissingScenesError
from tdgbench.splats.cpu import pool
from tdgbench.training.context import training_device


def run_cell(cfg: DictConfig, variant: str, progress: CellProgress) -> Outcome:
    """Run the cell that a resolved configuration describes.

    A failure of the cell is an outcome, not an exception, whatever its cause. Interrupts are raised, after the locks
    are released.
    """
    run, held, remark = None, ExitStack(), ""
    held.callback(progress.end)
    try:
        check_names(cfg)
        run = _cell_run(cfg, variant, progress)
        progress.begin(run.record.title)
        outcome = _run(run, held)
    except MissingScenesError as error:
        outcome = Outcome("missing", _title(cfg, run), str(error))
    except (Exception, SystemExit) as error:  # plug-ins may call sys.exit
        status: Status = "no prior" if isinstance(error, PriorUnavailableError) else "failed"
        outcome = Outcome(status, _title(cfg, run), _keep_failure(error, run))
    finally:
        if run is not None and run.is_locked:
            run.withdraw()
        try:
            held.close()
        except Exception as error:  # changes no outcome
            remark = f"clearing up: {failures.message(error)}"
    return replace(outcome, message="; ".join(filter(None, [outcome.message, remark])))


def known_outcome(cfg: DictConfig, variant: str) -> Outcome | None:
    """Return the outcome of a cell that `run_cell` would not run; None if it has to run, or if another process runs it.

    Raises what `run_cell` tells as a failure.
    """
    check_options(cfg)
    quiet = CellProgress(Console(quiet=True), 0, cells_at_once=None)
    run = _cell_run(cfg, variant, quiet)
    try:
        run.identify()
    except MissingScenesError as error:
        return Outcome("missing", _title(cfg, run), str(error))
    with ExitStack() as held:
        outcome = _outcome_on_disk(run, held)
    return None if outcome is not None and outcome.status == "elsewhere" else outcome


def _cell_run(cfg: DictConfig, variant: str, progress: CellProgress) -> CellRun:
    method, scene, init, experiment = (str(name) for name in (cfg.method.name, cfg.scene, cfg.init.name, cfg.name))
    record = Record(method, "", scene, init, int(cfg.seed), experiment, variant)
    return CellRun(cfg, record, Path(str(cfg.results)) / record.experiment, progress)


def _title(cfg: DictConfig, run: CellRun | None) -> str:
    """Return the name of a cell in messages, also if its options name none."""
    if run is not None:
        return run.record.title
    keys = ("method.name", "scene", "init.name", "seed")
    method, scene, init, seed = (OmegaConf.select(cfg, key, throw_on_resolution_failure=False) for key in keys)
    return f"{method} on {scene}, {init}, seed {seed}"


def _run(run: CellRun, held: ExitStack) -> Outcome:
    """Run a cell if it has to; locks are in `held` at the end."""
    cfg, record = run.cfg, run.record
    record.environment = describe_environment(run.progress.cells_at_once)
    check_options(cfg)
    pool.set_threads(cfg.threads)
    torch.set_num_threads(1)  # the kernels use a pool of threads; idle OpenMP workers would slow it down
    record.environment = describe_environment(run.progress.cells_at_once)  # with these threads
    cell = run.identify()
    on_disk = _outcome_on_disk(run, held)
    if on_disk is not None:
        return on_disk
    on_gpu = training_device(training_backend(cfg.backend.name)).type == "cuda"
    if on_gpu:
        torch.cuda.set_device(held.enter_context(exclusive_gpu(visible_gpus())))
        record.environment = describe_environment(run.progress.cells_at_once)
    with PeakMemory(on_gpu) as memory:
        trained = run.train(cell, run.load(cell))
    record.peak_rss_mb, record.peak_gpu_mb = memory.mb, memory.gpu_mb
    run.write(trained)
    changes = [] if run.existing is None else why_differs(run.existing, record)
    remarks = [f"run again, changed: {'; '.join(changes)}"] if changes else []
    remarks += [f"resumed after iteration {record.resumed[-1]}"] if record.resumed else []
    return finished(record, "; ".join([*remarks, *run.remarks]))


def _outcome_on_disk(run: CellRun, held: ExitStack) -> Outcome | None:
    """Return the outcome of a cell whose result is there, or hidden by a failure; None if it has to run.

    Its lock is in `held` afterwards, and the record in its folder in `run.existing`.
    """
    cfg, record = run.cfg, run.record
    if not held.enter_context(cell_lock(run.experiment, run.folder)):
        return Outcome("elsewhere", record.title, "another process is running it")
    run.is_locked = True
    finish_replacement(run.folder)
    existing = run.existing = readable_record(run.folder)
    outcome = None if existing is None else _outcome_without_run(existing, record, cfg)
    if outcome is None and cfg.overwrite != "always" and restore(run.folder, record, existing):
        outcome = Outcome("kept", record.title, "restored: its settings are those of an earlier result")
    if outcome is None:
        return None
    if outcome.status == "kept" and existing is not None and existing.key == record.key:
        run.discard_checkpoint()  # a run may have been ended between its result and this
    return replace(outcome, message="; ".join(filter(None, [outcome.message, *run.remarks])))


def _keep_failure(error: BaseException, run: CellRun | None) -> str:
    """Write the record of a failure if possible, and return the message of the outcome.

    Without a run, since its options name no cell, there is no record.
    """
    message = failures.message(error) + failures.place_of(error)
    if run is None:
        return message
    phase = run.current
    failure = failures.failure_of(error, phase)
    try:
        if not run.record.dataset:
            with suppress(Exception, SystemExit):
                run.locate()  # so that its record is where its result would be
        with ExitStack() as held:
            if not run.is_locked and not held.enter_context(cell_lock(run.experiment, run.folder)):
                raise OSError("another process is running the cell")
            written = write_failure(run.folder, run.record, failure)
            if written and not isinstance(error, failures.EXPECTED_ERRORS):
                message += f"; traceback: {run.folder / RECORD_FILE}"
    except Exception as unwritten:
        message += f" (its record could not be written: {unwritten})"
    return f"{phase}: {message}"


def _outcome_without_run(existing: Record, record: Record, cfg: DictConfig) -> Outcome | None:
    """Return the outcome of a cell that can be skipped, or None if it has to run."""
    if existing.failure is not None:
        is_retried = existing.failure.of_environment or cfg.overwrite == "always" or cfg.retry_failed
        if existing.key != record.key or is_retried:
            return None
        failure = f"{existing.failure.phase}: {existing.failure.error}"
        return Outcome("failed", record.title, f"{failure} (in an earlier run; retry_failed=true runs it again)")
    if cfg.overwrite == "always":
        return None
    if existing.key == record.key:
        return Outcome("kept", record.title)
    if cfg.overwrite == "never":
        changes = "; ".join(why_differs(existing, record))
        return Outcome("kept", record.title, f"overwrite=never keeps a result of other settings ({changes})")
    return None


def cell_lock(experiment: Path, folder: Path) -> AbstractContextManager[bool]:
    """Return a context that tries to lock the cell of `folder`, and tells whether it worked.

    The system releases a lock when its process ends, for whatever reason. Lock files are never removed: that would let
    a process that waits for the old file and one that makes a new file hold the lock at the same time.
    """
    return file_lock(experiment / "locks" / f"{short_name(experiment, folder)}.lock")


def write_failure(folder: Path, record: Record, failure: Failure) -> bool:
    """Replace the content of a cell's folder by the record of its failure; move a finished result to a hidden folder.

    A finished result stays in its place if the environment failed and the key is unknown or that of the result; returns
    whether the record was written. The caller must hold the cell's lock.
    """
    record.status, record.failure = "failed", Failure(**as_json(asdict(failure)))
    existing = readable_record(folder)
    if existing is not None and existing.status == "ok":
        if failure.of_environment and record.key in ("", existing.key):
            return False
        put_in_place(folder, hidden_folder(folder, existing.key))
    record.scores, record.train_scores, record.hashes, record.truth = {}, {}, {}, {}
    for name in ("config", "environment", "init_points", "prior"):
        setattr(record, name, as_json(getattr(record, name)))
    with whole_folder(folder) as part:
        record.write(part)
    return True


def restore(folder: Path, record: Record, existing: Record | None) -> bool:
    """Put the hidden result of the record's key back into a cell's folder, if its files are whole.

    existing: the record in the folder; a failure of the same key stays. The caller must hold the cell's lock.
    """
    hidden = hidden_folder(folder, record.key)
    kept = readable_record(hidden)
    if kept is None or kept.status != "ok" or kept.key != record.key:
        return False
    if existing is not None and existing.key == record.key:
        return False
    if not kept.hashes or not kept.hashes.items() <= hashes_below(hidden).items():
        return False
    put_in_place(hidden, folder)
    return True


def stored_in_words(experiment: Path) -> str:
    """Return what an interrupted run leaves on disk, in words: finished cells and the newest checkpoint."""
    records = [readable_record(path.parent) for path in record_files(experiment)]
    count = sum(record is not None and record.status == "ok" for record in records)
    cells = f"{count} finished {'cell' if count == 1 else 'cells'}"
    written = []
    for path in (experiment / CHECKPOINTS).glob("[!.]*.pt"):
        with suppress(OSError):  # another process has just removed it
            written.append(path.stat().st_mtime)
    state = f" and a checkpoint of {max(0, time.time() - max(written)):.0f} s ago" if written else ""
    return f"{experiment} keeps {cells}{state}; the same command goes on from there"
