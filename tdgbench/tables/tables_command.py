"""`tdgbench tables DIR ...`: rebuild the tables of results/<experiment> from disk, without training.

`tdgbench tables claims [DIR ...]`: test the paper's claims against its tables and against the cells of all these
experiments together.

`tdgbench tables sensitivity DIR ...`: score the stored renders by other conventions.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from tdgbench.cells.record import Record
from tdgbench.files import content_of, write_text
from tdgbench.scoring.backbones import SPECS
from tdgbench.tables.as_csv import as_csv
from tdgbench.tables.build import TableOptions, build_tables
from tdgbench.tables.claims import claims_table, judge_claims
from tdgbench.tables.claims.evidence import evidence_of
from tdgbench.tables.findings import claims_in_words
from tdgbench.tables.likeness import RANK_UNLIKE
from tdgbench.tables.palette import IMAGES, image_values, palette_notes
from tdgbench.tables.results import read_results
from tdgbench.tables.sensitivity import Weights, sensitivity
from tdgbench.tables.show import show_claims, show_problems, show_sensitivity, show_tables
from tdgbench.terminal import errors_in_one_line, say, show_findings
from tdgbench.text import first_few, one_line


def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a folder has no tables, or if something in it cannot be read."""
    parser = argparse.ArgumentParser(prog="tdgbench tables", description=__doc__)
    parser.add_argument("what", nargs="+", metavar="[claims|sensitivity] DIR", help="folders results/<experiment>")
    parser.add_argument("--weights", action="append", default=[], metavar="NET=FILE", type=_weights,
                        help="backbone of LPIPS for sensitivity, if torch's cache lacks it: vgg=vgg16.npz")  # fmt: skip
    parser.add_argument("--columns", type=lambda text: tuple(text.split(",")), default=(), metavar="NAME,...",
                        help="measures of the main table, as psnr,gaussians")  # fmt: skip
    parser.add_argument(RANK_UNLIKE, action="store_true", dest="is_ranking_unlike",
                        help="rank and average cells of unlike trainings: other budgets, versions ...")  # fmt: skip
    options = parser.parse_intermixed_args(arguments)
    what = options.what
    if what[0] == "claims":
        return errors_in_one_line("tables")(_claims)([Path(folder) for folder in what[1:]])
    build: Callable[[Path], int] = partial(_tables, options=TableOptions(options.columns, options.is_ranking_unlike))
    if what[0] == "sensitivity":
        build, what = partial(_sensitivity, weights=dict(options.weights)), what[1:]
        if not what:
            parser.error("sensitivity needs the folder of an experiment: results/<experiment>")
    return max(errors_in_one_line("tables")(build)(Path(folder)) for folder in what)


def _tables(experiment: Path, options: TableOptions) -> int:
    before = _contents(experiment)
    tables = build_tables(experiment, options)
    show_tables(tables)
    report = tables.results.report
    if report.exists() and before != _contents(experiment):
        say(f"{report} still shows the tables of before: the run's command makes it again, and trains nothing anew")
    show_findings(tables.findings)
    return int(bool(tables.problems))


def _contents(experiment: Path) -> list[bytes]:
    """Return the contents of the tables that a report shows; none of an experiment without."""
    files = [experiment / "tables" / name for name in ("main.csv", "findings.txt")]
    return [content_of(file) for file in files if file.is_file()]


def _weights(text: str) -> tuple[str, str]:
    """Read NET=FILE."""
    net, _, file = text.partition("=")
    if net not in SPECS or not file:
        raise argparse.ArgumentTypeError(f"{text!r} is not NET=FILE with a network of {', '.join(SPECS)}")
    if not Path(file).is_file():
        raise argparse.ArgumentTypeError(f"{file} is no file")
    return net, file


def _sensitivity(experiment: Path, weights: Weights) -> int:
    results = read_results(experiment, of_last_run=True)
    cells = results.finished
    table = sensitivity(cells, weights).assign(**{IMAGES: image_values(cell.record for cell in cells)})
    results.tables.mkdir(exist_ok=True)
    write_text(results.tables / "sensitivity.csv", as_csv(table, na_rep="n/a"))
    show_problems(results.problems)
    show_sensitivity(table)
    say(one_line(_what_is_of([cell.record for cell in cells], experiment.resolve().name)))
    for note in palette_notes(table):
        say(note)
    return int(bool(results.problems))


def _what_is_of(records: Sequence[Record], name: str) -> str:
    """Return of what changes are, in words: other scenes, or images of other channels, may change otherwise."""
    scenes = list(dict.fromkeys(record.scene for record in records))
    channels = " or ".join(map(str, sorted({record.channels for record in records})))
    built_in = ", built in" * all(record.is_of_built_in_scene for record in records)
    return f"of {name}: {len(records)} cells of {first_few(scenes)}{built_in}; images of {channels} channels"


def _claims(experiments: list[Path]) -> int:
    """Check the paper's claims against the published tables and all cells of the experiments; write them to each."""
    evidence = evidence_of(experiments) if experiments else None
    claims = judge_claims(evidence)
    ours = ", ".join(folder.resolve().name for folder in experiments)
    for experiment in experiments:
        folder = experiment / "tables"
        folder.mkdir(parents=True, exist_ok=True)
        write_text(
            folder / "claims.csv",
            as_csv(claims_table(claims).assign(experiments=ours), as_is=("published_seen", "ours_seen")),
        )
    show_claims(claims)
    if evidence is not None:
        say(f"our results: {ours}")
        for _, sentence in evidence.not_counted:
            say(one_line(sentence))
    problems = [problem for folder in experiments for problem in read_results(folder).problems]
    show_problems(problems)
    show_findings(claims_in_words(claims))
    return int(bool(problems))
