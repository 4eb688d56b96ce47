"""Ground truth of training views, which cells do not store, from the data set that a cell was trained on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import OmegaConf

from tdgbench.bench.record import Record
from tdgbench.resources import conf_folder
from tdgbench.scenes import View
from tdgbench.scenes.synthetic import SyntheticDataset


def training_views(record: Record, root: Path) -> dict[str, View]:
    """Return the training views of a cell by name, read from the data below `root`; nothing is written.

    root: as `data.root`. Raises ValueError, in words, if the data are not there or not those of the cell.
    """
    loader = record.setting("dataset")
    targets = list(_targets(loader))
    if not targets or not known_targets().issuperset(targets):
        raise ValueError("its data set is not one of tdgbench's")
    if record.setting("camera.estimate") or record.setting("contrast.training") not in (None, "none"):
        raise ValueError("it was trained on images that camera or contrast changed, which are not stored")
    try:
        dataset = instantiate(_with_root(loader, str(root)))
        if isinstance(dataset, SyntheticDataset) and not dataset.folder(record.scene).exists():
            raise ValueError(f"{dataset.folder(record.scene)} is not there")
        scene = dataset.load(record.scene)
    except Exception as error:  # hydra's have the cause
        raise ValueError(str(error.__cause__ or error)) from error
    if scene.fingerprint != record.data:
        raise ValueError(f"the files of {record.scene} in {root} are not those that it was trained on")
    return {view.name: view for view in scene.train}


@cache
def known_targets() -> frozenset[str]:
    """Return the classes that data sets in `conf/` name. Nothing else that a record names is run."""
    files = [conf_folder() / "read_options.yaml", *(conf_folder() / "dataset").glob("*.yaml")]
    return frozenset(one for path in files for one in _targets(OmegaConf.to_container(OmegaConf.load(path))))


def _with_root(loader: dict[str, Any], root: str) -> dict[str, Any]:
    """Return a loader's options with the folder, which goes to the innermost loader."""
    if "inner" in loader:
        return {**loader, "inner": _with_root(loader["inner"], root)}
    return {**loader, "root": root}


def _targets(config: object) -> Iterator[str]:
    """Yield every `_target_` of a configuration, at any depth."""
    if isinstance(config, Mapping):
        if "_target_" in config:
            yield str(config["_target_"])
        for value in config.values():
            yield from _targets(value)
    elif isinstance(config, list):
        for value in config:
            yield from _targets(value)
