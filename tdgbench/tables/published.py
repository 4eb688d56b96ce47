"""Published numbers of this paper and others, from CSV in `paper_tables/`, with the keys of our tables."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from tdgbench.resources import paper_tables_folder
from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.tables.measures import AVERAGE, OVERALL

FOLDER = paper_tables_folder()
PAPER = "tdg"  # the source whose tables are reproduced
OVER_OTHERS = "our average is over other scenes than the paper's"


def published_main() -> pd.DataFrame:
    """Read Table 1: method, dataset, group, scene, metric, value, bold. Scenes of averages contain `Average`."""
    return pd.read_csv(FOLDER / "table1.csv", keep_default_na=False)


def published_ablation() -> pd.DataFrame:
    """Read Table 2: method, init, metric, value; means over the 14 scenes."""
    return pd.read_csv(FOLDER / "table2.csv")


def is_over_papers_scenes(scenes: Iterable[tuple[str, str]], dataset: str = "") -> bool:
    """Return whether (data set, scene) are the paper's, all of them and no others. dataset: in which; empty: all."""
    papers = {(DATASETS[scene.dataset], scene.name) for scene in SCENES}
    one, other = ({place for place in places if dataset in ("", place[0])} for places in (papers, set(scenes)))
    return one == other


def with_papers_averages(main: pd.DataFrame) -> pd.DataFrame:
    """Return a main table in which averages over other scenes than the paper's are n/a: no printed ones are theirs."""
    is_average = main["scene"].isin((AVERAGE, OVERALL))
    scenes = set(main.loc[~is_average, ["dataset", "scene"]].itertuples(index=False, name=None))
    of_papers = {name: is_over_papers_scenes(scenes, name) for name in main["dataset"].unique()}
    others = is_average & ~main["dataset"].map(of_papers) & main["value"].notna()
    return main.assign(value=main["value"].mask(others), reason=main["reason"].mask(others, OVER_OTHERS))


def load_sources() -> dict[str, dict[str, Any]]:
    """Load the papers and pages with numbers, by their name in the CSV files.

    selected_on: what chose the models that were scored. methods: by printed name, our method (`as`), whether the source
    settles it (`sure`), and a `note`.
    """
    entries: dict[str, Any] = OmegaConf.to_container(OmegaConf.load(FOLDER / "sources.yaml"))  # type: ignore[assignment]
    return {name: {"selected_on": "not known here", "methods": {}, **entry} for name, entry in entries.items()}


def published_elsewhere() -> pd.DataFrame:
    """Read other papers' numbers for the same scenes: source, method, dataset, group, scene, metric, value, printed_as.

    method is our name where sources.yaml has one, else the printed name (printed_as). Averages are rows with the scene
    `Average`. Raises ValueError for a source that sources.yaml lacks.
    """
    table = pd.read_csv(FOLDER / "others.csv", keep_default_na=False)
    sources = load_sources()
    unknown = set(table["source"]) - set(sources)
    if unknown:
        raise ValueError(f"{FOLDER / 'sources.yaml'} lacks {', '.join(sorted(unknown))}")
    table["printed_as"] = table["method"]
    table["method"] = [
        sources[source]["methods"].get(method, {}).get("as", method)
        for source, method in zip(table["source"], table["method"], strict=True)
    ]
    return table.assign(group="")[["source", "method", "dataset", "group", "scene", "metric", "value", "printed_as"]]


def printed_half_unit(printed: str) -> float:
    """Return half a unit of the last digit of a printed number: how far it may be from the number itself.

    >>> printed_half_unit("27.42")
    0.005
    """
    return 0.5 * 10.0 ** int(Decimal(printed).as_tuple().exponent)
