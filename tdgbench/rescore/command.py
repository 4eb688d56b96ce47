"""`tdgbench score DIR OUT [metrics=CHOICE metrics.OPTION=VALUE ...]`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf

from tdgbench.bench.failures import error_message, message, place_of
from tdgbench.bench.options import check_options
from tdgbench.bench.run_cell import cell_lock
from tdgbench.cells.folder import CellFolder, is_same_training, read_cells
from tdgbench.cells.key import as_json, relevant_metrics
from tdgbench.cells.known_classes import add_trust_arguments, extra_of, trust, trust_also
from tdgbench.cells.metric_settings import metric_settings, scorer_of
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.plan import read_plan
from tdgbench.cells.record import no_records
from tdgbench.experiments.sweep.finish import write_all
from tdgbench.files import whole_folder
from tdgbench.packs import opened_pack
from tdgbench.rescore.cell import score_cell
from tdgbench.resources import conf_folder
from tdgbench.scoring import Scorer
from tdgbench.scoring.metrics.lpips import LPIPS
from tdgbench.scoring.scorer import MetricFault
from tdgbench.tables.measures import entries_of
from tdgbench.terminal import errors_in_one_line, say, show_findings
from tdgbench.text import one_line

ALL = ""  # what metrics=CHOICE names
OF_WEIGHTS = {ALL, "lpips.net", "lpips.weights"}


@errors_in_one_line("score")
def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a cell could not be scored, or nothing could be."""
    parser = argparse.ArgumentParser(
        prog="tdgbench score", description="Score the stored renders of finished cells by another protocol, without "
        "training. Each cell keeps the options that are not named, and gets the metrics that it lacks.",
    )  # fmt: skip
    parser.add_argument(
        "experiment", type=Path, metavar="DIR", help="folder results/<experiment>, or a pack; it stays as it is"
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="results folder of the scores: new, or of an earlier run")
    parser.add_argument("options", nargs="*", metavar="OPTION", help="metrics=CHOICE, metrics.OPTION=VALUE")
    add_trust_arguments(parser)
    given = parser.parse_intermixed_args(arguments)
    trust(given.config_dir, given.trust)
    with opened_pack(given.experiment) as experiment:
        failed = score_experiment(experiment, given.out, given.options, given.config_dir)
    show_findings(write_all(given.out))
    say("not compared: the ground truth is what the cells hold; tdgbench verify compares it", "data:")
    return int(failed)


def _check_out(out: Path, cells: Iterable[CellFolder]) -> None:
    """Raise ValueError if a finished cell in `out` is none of these cells."""
    known = {cell_folder_of(out, cell.record): cell for cell in cells if cell.record.failure is None}
    for there in read_cells(out) if out.exists() else ():
        if there.record.failure is None and not (
            there.folder in known and is_same_training(known[there.folder].record, there.record)
        ):
            raise ValueError(f"{there.folder} holds another training; name a new folder, or delete it")


class Chosen(NamedTuple):
    """Options of `metrics` as records keep them, and those that the command line names; all of them by a choice.

    download: whether LPIPS may download a missing backbone; None: of cells that have an LPIPS.
    """

    metrics: dict[str, Any]
    named: frozenset[str] = frozenset()
    download: bool | None = None

    def of_cell(self, own: dict[str, Any]) -> dict[str, Any]:
        """Return the options for a cell with these of its own, which stay where the command line names no other."""
        if ALL in self.named:
            return self.metrics
        merged = {**own, **{name: self.metrics.get(name) for name in self.named if "." not in name}}
        if "lpips.net" in self.named:
            merged["lpips"] = self.metrics["lpips"]
        elif "lpips.weights" in self.named:
            lpips = {n: v for n, v in own["lpips"].items() if n != "weights_sha256"}
            merged = relevant_metrics({**merged, "lpips": {**lpips, "weights": self.metrics["lpips"]["weights"]}})
        return {name: value for name, value in merged.items() if name != "extra" or value}


def score_experiment(experiment: Path, out: Path, words: list[str], config_dirs: Sequence[Path] = ()) -> bool:
    """Score the cells of an experiment into another one; return whether one of them could not be scored.

    Raises ValueError for a folder without finished cells, words that are no options of `metrics`, and an `out` that
    holds a finished training of another experiment.
    """
    chosen = read_options(words, config_dirs) if words else None
    cells = read_cells(experiment)
    if not cells:
        raise no_records(experiment)
    if not any(cell.record.failure is None for cell in cells):
        raise ValueError(f"{experiment} holds no finished cell")
    if out.resolve() == experiment.resolve():
        raise ValueError(f"{out} holds the first scores, which are kept; name another folder")
    _check_out(out, cells)
    scorers: dict[str, Scorer] = {}  # each loads LPIPS's network once for all cells
    plan = read_plan(experiment)
    plan.own_metrics |= entries_of(extra_of(chosen.metrics)) if chosen else {}
    plan.write(out)
    failed = False
    for cell in cells:
        record = cell.record
        target, record.experiment = cell_folder_of(out, record), out.resolve().name
        try:
            with cell_lock(out, target) as is_held:
                if not is_held:
                    raise ValueError("another process works on it")
                outcome, is_whole = _score(cell, target, chosen, scorers)
                failed = failed or not is_whole
        except (ValueError, OSError) as error:
            failed, outcome = True, f"not scored: {error}"
        except (Exception, SystemExit) as error:  # a method of the user may raise anything; the others are scored
            failed, outcome = True, f"not scored: {message(error)}{place_of(error)}"
        say(one_line(f"{record.title}: {outcome}"))
    return failed


def _score(cell: CellFolder, target: Path, chosen: Chosen | None, scorers: dict[str, Scorer]) -> tuple[str, bool]:
    """Score a cell, or hand the record of a failed one on; return what was done, and whether no metric failed."""
    record = cell.record
    if record.failure is not None:
        with whole_folder(target) as part:
            record.write(part)
        return record.why_failed, True
    metrics, download = record.setting("metrics"), None
    weights = None  # a file that a record names is not opened
    metric_settings(metrics)
    if chosen:
        metrics, download = chosen.of_cell(metrics), chosen.download
        weights = metrics["lpips"]["weights"] if chosen.named & OF_WEIGHTS else None
    if download is None:
        download = record.scores.get(LPIPS.name) is not None
    scorer = scorer_of(metric_settings(metrics), download, weights and Path(weights), extra_of(metrics))
    scorer = scorers.setdefault(json.dumps([metrics, download], sort_keys=True), scorer)
    scores = score_cell(cell, target, scorer, metrics)
    why = {m: scorer.missing.get(m, "") for m in scores if scores[m] is None}
    faulty = [m for m, reason in why.items() if isinstance(reason, MetricFault)]
    by_outcome: dict[str, list[str]] = {}
    for m in scores:
        if m not in faulty:
            by_outcome.setdefault(f"n/a ({why[m]})" if m in why else "computed", []).append(m)
    done = [f"{', '.join(names)} {outcome}" for outcome, names in by_outcome.items()]
    return "; ".join([*done, *(f"{m} {why[m]}" for m in faulty)]) or "already there", not faulty


def read_options(words: list[str], config_dirs: Sequence[Path] = ()) -> Chosen:
    """Return the options of `metrics` that a training has with these words; metrics that they name are trusted.

    Raises ValueError for other options.
    """
    for word in words:
        if not word.startswith(("metrics=", "metrics.")):
            raise ValueError(f"{word} decides what is read or trained, which takes a training; only metrics=CHOICE and "
                             "metrics.OPTION=VALUE can be chosen here")  # fmt: skip
    try:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            searched = ",".join(f"'file://{folder.absolute()}'" for folder in config_dirs)
            cfg = compose("config", overrides=[*words, f"hydra.searchpath=[{searched}]"])
    except HydraException as error:
        raise ValueError(error_message(error, words)) from error
    trust_also(as_json(OmegaConf.to_container(cfg.metrics)).get("extra") or [])
    check_options(cfg)
    download = cfg.metrics.lpips.download
    if download and not any(word.startswith("metrics.lpips.download=") for word in words):
        download = None
    named = frozenset(word.partition("=")[0].removeprefix("metrics").removeprefix(".") for word in words)
    return Chosen(relevant_metrics(as_json(OmegaConf.to_container(cfg.metrics))), named, download)
