"""The pages of a site: index, scenes, methods, packs. Links are relative: they work from disk and on any host."""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from math import inf, isnan
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tdgbench.cells.ground_truth import truth_groups
from tdgbench.cells.key import flat
from tdgbench.cells.protocol import MEASURED_ON
from tdgbench.cells.record import Record
from tdgbench.files import whole_folder
from tdgbench.packs.manifest import SHOWN
from tdgbench.present.grid import GridCell
from tdgbench.present.html import environment
from tdgbench.report.report_page import legend
from tdgbench.report.run_facts import environments
from tdgbench.resources import conf_folder
from tdgbench.scenes.registry import is_built_in
from tdgbench.site.packed import (
    ERROR,
    HEADS,
    SCORES,
    BoardRow,
    Pack,
    joined,
    method_page,
    opened_packs,
    rows_of,
    scene_page,
)
from tdgbench.site.picture_cards import cards_of, files_of_cards
from tdgbench.site.psnr_time_plot import plots
from tdgbench.site.ranking import ranked
from tdgbench.tables import methods
from tdgbench.tables.assumptions import assumed_rows, doubts_of
from tdgbench.tables.claims import judge_claims, load_claims
from tdgbench.tables.claims.evidence import ClaimEvidence, JudgedClaim, evidence_of
from tdgbench.tables.columns import own_columns
from tdgbench.tables.comparisons import margins_in_words
from tdgbench.tables.equal_data import Place, equal_in_words, equal_scenes
from tdgbench.tables.findings import BEFORE_A_PLATEAU, ended_by_its_budget
from tdgbench.tables.grids import SCENE_KEYS, TIMES, reasons_for_na
from tdgbench.tables.likeness import (
    SELECTED,
    disturbed_notes,
    is_selected,
    machine_in_words,
    setups,
    times_at_once,
)
from tdgbench.tables.long_table import method_label, metric_value
from tdgbench.tables.measures import AVERAGE, HOURS, as_text, measure_of
from tdgbench.tables.overrides import filed, override_notes, training_in_words
from tdgbench.tables.palette import IN_SOME, MARK, WORDS
from tdgbench.tables.published_setup import BUDGET
from tdgbench.tables.results import Cell
from tdgbench.terminal import errors_in_one_line, say


@errors_in_one_line("site")
def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a pack cannot be read, or the folder is there."""
    parser = argparse.ArgumentParser(
        prog="tdgbench site", description="Write web pages from packs: a leaderboard, a page per scene, method, pack."
    )  # fmt: skip
    parser.add_argument("pack", nargs="+", type=Path, metavar="PACK", help="written by tdgbench pack")
    parser.add_argument("folder", type=Path, metavar="DIR", help="the new folder of the pages")
    parser.add_argument("--title", default="", metavar="TEXT", help="of the site; default names the data sets")
    options = parser.parse_intermixed_args(arguments)
    with opened_packs(options.pack) as packs:
        pages = write_site(packs, options.folder, options.title)
    sizes = [path.stat().st_size for path in options.folder.rglob("*") if path.is_file()]
    say(f"{options.folder / 'index.html'}: {pages} pages, {len(sizes)} files, {sum(sizes) / 2**20:.2f} MB")
    return 0


def write_site(packs: Sequence[Pack], folder: Path, title: str = "") -> int:
    """Write the pages of packs into a new folder, whole or not at all; return their number.

    title: default names the data sets. Raises FileExistsError if the folder is there, and ValueError without a finished
    cell.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} is there already; remove it, or name a new folder")
    cells = [cell for pack in packs for cell in pack.cells]
    truths, alike = truth_groups(cells), setups([cell.record for cell in cells], with_length=True)
    by_folder = {
        cell.folder: json.dumps({**json.loads(setup)[-1], "ground truth": truths[cell.folder],
                                 **{name: getattr(cell.record, name) for name in MEASURED_ON}})
        for cell, setup in zip(cells, alike, strict=True)
    }  # fmt: skip
    rows = ranked(row for pack in packs for row in rows_of(pack, by_folder))
    if not rows:
        raise ValueError("the packs hold no finished cell")
    site = _Site(packs, rows, title or f"Thermal Gaussian splatting on {joined(sorted(r.dataset for r in rows))}")
    with whole_folder(folder) as part:
        for place, content in sorted(site.files().items()):
            path = part / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return site.pages


class _Site:
    """The files of a site, made from packs and rows of their leaderboards."""

    def __init__(self, packs: Sequence[Pack], rows: Sequence[BoardRow], title: str) -> None:
        self.packs, self.rows, self.pages = packs, rows, 0
        self.environment = environment("tdgbench.site")
        self.environment.filters["link"] = quote
        self.environment.globals.update(
            site_title=title,
            heads=HEADS,
            scene_page=scene_page,
            method_page=method_page,
            shown=SHOWN,
            mark=MARK,
            psnr=measure_of("psnr"),
            margins=margins_in_words(),
            nothing=GridCell(),
        )

    def files(self) -> dict[str, bytes]:
        """Return the content of every file by its place."""
        scenes: dict[str, list[str]] = {}
        for dataset, scene in sorted({(row.dataset, scene) for row in self.rows for scene in row.scenes}):
            scenes.setdefault(dataset, []).append(scene)
        files = {"index.html": self._page("index.html.j2", "", boards=boards_of(self.rows), packs=self.packs,
                                          legend=self._legend(), data={in_words(n): s for n, s in scenes.items()},
                                          equal=dict.fromkeys(equal_data(self.packs).values()))}  # fmt: skip
        for name in ("site.css", "site.js"):
            files[name] = self.environment.get_template(f"{name}.j2").render().encode()
        for dataset, scene in sorted({(row.dataset, row.scene) for row in self.rows if not row.is_average}):
            files |= self._scene(dataset, scene)
        names = sorted({row.method for row in self.rows})
        evidence = evidence_of([pack.tables.results.folder for pack in self.packs])
        claims = _claims(evidence, names)
        for name in names:
            rows = [row for row in self.rows if row.method == name]
            files[method_page(name)] = self._page(
                "method.html.j2", "../", name=name, label=joined(row.pack.label(name) for row in rows),
                is_known=file_of(name) is not None, claims=claims[name], reading=reading_of(name, self.packs),
                boards=boards_of(rows), 
                not_counted=[sentence for method, sentence in evidence.not_counted if method == name],
            )  # fmt: skip
        for pack in self.packs:
            shown = (*SCORES, *pack.own_metrics)
            with own_columns(pack.plan):
                files[pack.page] = self._page(
                    "pack.html.j2", "../", pack=pack, environments=environments(pack.tables.records),
                    notes=_notes(pack.cells), doubts=doubts_of(cell.record for cell in pack.cells),
                    cells=cell_rows(pack.tables.records, shown), titles=[measure_of(name).title for name in shown],
                    reasons=reasons_for_na(pack.tables.main, shown),
                    boards=boards_of([row for row in self.rows if row.pack is pack]),
                )  # fmt: skip
        return files

    def _legend(self) -> list[dict[str, str]]:
        """Return what the scores of the leaderboards mean."""
        return list({row["title"]: row for pack in self.packs for row in legend(pack.tables)
                     if row["title"] in HEADS}.values())  # fmt: skip

    def _scene(self, dataset: str, scene: str) -> dict[str, bytes]:
        """Return a scene's page and its pictures."""
        sections = cards_of(self.packs, dataset, scene)
        files = files_of_cards([card for section in sections for card in section])
        rows = [row for row in self.rows if (row.dataset, row.scene) == (dataset, scene)]
        cells = []
        for pack in self.packs:
            with own_columns(pack.plan):
                cells += [(f"{pack.name}, {cell.label}", cell.record) for cell in pack.cells
                          if cell.dataset_and_scene == (dataset, scene)]  # fmt: skip
        page = self._page("scene.html.j2", "../../", dataset=dataset, scene=scene, sections=sections,
                          assumed=assumed_rows(cells), doubts=doubts_of(record for _, record in cells),
                          boards=boards_of(rows), equal=equal_data(self.packs).get((dataset, scene)))  # fmt: skip
        return {scene_page(dataset, scene): page, **files}

    def _page(self, template: str, root: str, **content: Any) -> bytes:
        """Return a page; messages about files name their place in the pack."""
        self.pages += 1
        text = self.environment.get_template(template).render(root=root, **content)
        for pack in self.packs:
            text = text.replace(f"{pack.tables.results.folder}/", "")
        return text.encode()


def in_words(dataset: str) -> str:
    """Return a data set's name, with what it is where the name does not say it."""
    if is_built_in(dataset):
        return f"{dataset} (built into tdgbench)"
    return f"{dataset} (scenes that were read from a folder)" if dataset == "folder" else dataset


def boards_of(rows: Iterable[BoardRow]) -> list[dict[str, Any]]:
    """Return the leaderboards of rows, one for each data set, protocol and budget: settings, rows, plots of a scene."""
    groups: dict[tuple[str, str, str], list[BoardRow]] = {}
    for row in rows:
        groups.setdefault((row.dataset, row.protocol, row.training), []).append(row)
    boards: list[dict[str, Any]] = []
    for (dataset, protocol, training), group in sorted(groups.items()):
        group.sort(key=lambda row: (not row.is_average, row.scene, row.scenes, *_place(row)))
        averages = Counter(tuple(row.scenes) for row in group if row.is_average)
        widest = list(averages.most_common(1)[0][0]) if averages else group[0].scenes
        facts = list(group[0].facts)
        shown = [i for i, name in enumerate(SCORES)
                 if name != ERROR or any(not isnan(row.scores[i].value) for row in group)]  # fmt: skip
        boards.append({
            "dataset": dataset, "protocol": protocol, "training": training, "rows": group,
            "settings": {name: json.dumps(value) for name, value in group[0].settings.items()},
            "shown": shown,
            "behind": [[row.label, row.pack.name, row.scene, head, cell.title] for row in group
                       for head, cell in zip(HEADS, row.scores, strict=True) if cell.note],
            "facts": [name for name in facts if any(row.facts[name] != "n/a" for row in group)],
            "plots": plots([row for row in group if row.scenes == widest] if averages else group),
            "own": sorted({key for row in group for key in row.own}),
            "unlike": _scenes_by_reason(group), "means_unlike": any(row.is_average and row.is_unlike for row in group),
            "palette": palette_in_words(group), "notes": _notes_of(group),
            "caveats": _caveats(group), "reasons": _reasons(group, shown),
        })  # fmt: skip
    for board in boards:
        others = [one["settings"] for one in boards if one["dataset"] == board["dataset"]]
        board["apart"] = [f"{name}: {_short(value)}" for name, value in board["settings"].items()
                          if any(other.get(name) != value for other in others)]  # fmt: skip
    return boards


def _notes_of(rows: Sequence[BoardRow]) -> list[str]:
    """Return what the times of a leaderboard include, and the network of its LPIPS."""
    nets = dict.fromkeys(str(one.setting("metrics.lpips.net")) for row in rows for one in row.records
                         if one.scores.get("lpips") is not None)  # fmt: skip
    return [TIMES, *([f"LPIPS network: {', '.join(nets)}"] if nets else [])]


def _short(text: str) -> str:
    """Return a text with the first digits of each SHA-256."""
    return re.sub("[0-9a-f]{64}", lambda found: f"{found[0][:SHOWN]}…", text)


def _caveats(rows: Sequence[BoardRow]) -> list[str]:
    """Return what the scores of a leaderboard are no evidence of, and what depth priors are given."""
    given: dict[str, dict[str, None]] = {}
    for row in rows:
        for record in row.records:
            given.setdefault(record.prior_source.in_full, {})[row.pack.label(row.method)] = None
    are_built_in = all(record.is_of_built_in_scene for row in rows for record in row.records)
    found = ["Built-in scenes: no evidence on the paper."] if are_built_in else []
    if any(record.has_made_up_points for row in rows for record in row.records):
        found.append("Initial points of built-in scenes (colmap) are drawn from true depth, with noise.")
    trained = [record for row in rows for record in row.records if record.made_elsewhere is None]
    named = [record.setting("budget.name") for record in trained]
    shipped = {f"budget {name}" for name in named if isinstance(name, str) and filed("budget", name) is not None}
    if others := sorted(shipped - {BUDGET}):
        found.append(f"With {joined(others)}, lengths and rules of growth, resets and rates are tdgbench's own, "
                     f"for all methods; the authors' are those of {BUDGET}.")  # fmt: skip
    if all(ended_by_its_budget(record) for row in rows for record in row.records):
        found.append(f"{BEFORE_A_PLATEAU}.")
    if chosen := dict.fromkeys(row.label for row in rows if any(map(is_selected, row.records))):
        found.append(f"{joined(chosen)}: {SELECTED}. Not ranked.")
    timed = [row for row in rows if not isnan(row.scores[SCORES.index(HOURS.name)].value)]
    machines = set[tuple[str, ...]]().union(*(row.machines for row in timed))
    if len(machines) > 1:
        found.append(f"Times do not compare between: {'; '.join(sorted(map(machine_in_words, machines)))}.")
    records = list({cell.folder: cell.record for row in timed for cell in row.cells}.values())  # each once
    found += [f"{note[0].upper()}{note[1:]}." for note in (*times_at_once(records), *disturbed_notes(records))]
    for row in rows:
        with own_columns(row.pack.plan):
            notes = override_notes(row.records, lambda _, column=row.column: column)  # type: ignore[misc]
        found += [one for note in notes if (one := f"{row.pack.name}: {note}.") not in found]
    return found + [f"The depth prior of {', '.join(who)} is made from {what}." for what, who in given.items() if what]


def _reasons(rows: Sequence[BoardRow], columns: Sequence[int]) -> list[str]:
    """Return why scores of a leaderboard are n/a. columns: those that are shown."""
    found: dict[str, None] = {}
    for pack in dict.fromkeys(row.pack.page for row in rows):
        of_pack = [row for row in rows if row.pack.page == pack]
        main = of_pack[0].pack.tables.main.set_index(SCENE_KEYS, drop=False)
        places = [(row.dataset, row.scene, row.column) for row in of_pack]
        with own_columns(of_pack[0].pack.plan):
            shown = main[main.index.isin(places)].replace({"scene": {AVERAGE: "the mean"}}).reset_index(drop=True)
            found |= dict.fromkeys(reasons_for_na(shown, [SCORES[i] for i in columns]))
    return list(found)


def _scenes_by_reason(rows: Iterable[BoardRow]) -> dict[str, list[str]]:
    """Return scenes whose rows are not ranked, by the reason: they differ, or a record was changed."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.is_unlike and not row.is_average and row.scene not in found.get(row.unranked, []):
            found.setdefault(row.unranked, []).append(row.scene)
    return found


def _place(row: BoardRow) -> tuple[float, float, bool, str]:
    """Return what sorts the rows of a scene: rank, PSNR, pack."""
    psnr = row.scores[SCORES.index("psnr")].value
    return row.ranks[0] if row.ranks else inf, inf if isnan(psnr) else -psnr, bool(row.twin), row.pack.page


def palette_in_words(rows: Iterable[BoardRow]) -> str:
    """Return what the mark of rows says; empty if no row has one."""
    found = {row.image_values for row in rows} - {""}
    partly = "; some means with it are over other scenes as well" if IN_SOME in found else ""
    return f"{MARK} {WORDS}{partly}" if found else ""


def equal_data(packs: Iterable[Pack]) -> dict[Place, str]:
    """Return a sentence for each scene that has the test images of another one, once for a pair of scenes."""
    equal = equal_scenes(cell.record for pack in packs for cell in pack.cells)
    sentences = {twin: equal_in_words(twin, first) for twin, first in equal.items()}
    return {first: sentences[twin] for twin, first in equal.items()} | sentences


def cell_rows(records: Iterable[Record], shown: Sequence[str]) -> list[list[str]]:
    """Return a row for each cell of a pack: what it is, the measures that are shown, and why it failed."""
    return [
        [methods.label(method_label(r, with_init=True)), f"{r.dataset}/{r.scene}", str(r.seed), training_in_words(r),
         *("n/a" if isnan(value := metric_value(r, name)[0]) else as_text(name, value) for name in shown),
         r.why_failed if r.failure else "finished"] for r in records
    ]  # fmt: skip


def file_of(method: str) -> Path | None:
    """Return the file of a method of tdgbench; None for others."""
    return {path.stem: path for path in (conf_folder() / "method").glob("*.yaml")}.get(method)


def reading_of(method: str, packs: Sequence[Pack]) -> str:
    """Return what was read from paper and code: the method's file, or without it, its options in a record."""
    if path := file_of(method):
        return path.read_text(encoding="utf-8")
    record = next(cell.record for pack in packs for cell in pack.cells if cell.record.method == method)
    options = record.setting("method.method")
    named = flat(options) if isinstance(options, dict) else {}
    return "\n".join(f"{name}: {json.dumps(value)}" for name, value in named.items())


def _claims(evidence: ClaimEvidence, names: Sequence[str]) -> dict[str, list[JudgedClaim]]:
    """Return the claims that name each method, with verdicts on the published numbers and on those of all packs."""
    claims, pair = load_claims(), methods.paper_pair()
    judged = judge_claims(evidence, claims)
    named = [{*(claim.methods or pair), *claim.against} for claim in claims]
    return {name: [one for one, of_claim in zip(judged, named, strict=True) if name in of_claim] for name in names}


def _notes(cells: Sequence[Cell]) -> dict[str, list[str]]:
    """Return the titles of cells by note."""
    notes: dict[str, list[str]] = {}
    for cell in cells:
        for note in cell.record.notes:
            notes.setdefault(note, []).append(cell.record.title)
    return notes
