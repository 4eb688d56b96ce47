"""Verdicts on published numbers need cells of the published setup."""

from __future__ import annotations

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.tables.build import build_tables
from tdgbench.tables.published_setup import departures
from tdgbench.tables.verdicts import NEVER, REPRODUCED
from tests.helpers.records import write

PSNR = (26.80, 26.81, 26.79)  # published: 26.80


def published(method, config, **fields):
    return Record(method, "RGBT-Scenes", "Truck", "colmap", 0, "", "", config=config, **fields)


@pytest.mark.parametrize(
    ("fields", "metric", "said"),
    [
        ({"config": {"budget": {"name": "demo"}}}, "psnr", "budget demo"),
        ({"config": {"budget": {"name": "paper", "sh_degree": 0}}}, "psnr", "budget paper with sh_degree=0"),
        ({"split": "every_8th"}, "psnr", "data.split=every_8th"),
        ({"prior": {"made_from": "points"}}, "ssim", "depth prior made from the scene's sparse points"),
        ({"config": {"budget": {"name": "paper"}, "metrics": {"lpips": {"net": "squeeze"}}}}, "lpips",
         "metrics.lpips.net=squeeze"),
        ({"config": {"budget": {"name": "paper"}, "metrics": {"lpips": {"net": "squeeze"}}}}, "psnr", ""),
        ({"config": {"budget": {"name": "paper"}, "dataset": {"options": {"width": 320}}}}, "psnr", "data.width=320"),
        ({"config": {"budget": {"name": "paper"}, "thermal_camera": {"estimate": True}}}, "psnr",
         "thermal_camera.estimate=true"),
        ({"config": {"budget": {"name": "paper"}, "metrics": {"lpips": {"net": "vgg", "weights_sha256": "a"}}}},
         "lpips", "metrics.lpips.weights_sha256=a"),
    ],
)  # fmt: skip
def test_what_departs_is_not_judged(tmp_path, fields, metric, said):
    """The numbers are those of print; with another setup they reproduce nothing."""
    for seed, psnr in enumerate(PSNR):
        scores = {"psnr": psnr, "ssim": 0.893 + 1e-4 * seed, "lpips": 0.200}
        write(tmp_path, "msmg", "Dimsum", seed=seed, scores=scores, **fields)
    tables = build_tables(tmp_path)
    row = tables.difference.query("scene == 'Dimsum' and method == 'msmg'").set_index("metric").loc[metric]
    assert (row["verdict"] == NEVER) == bool(said) and said in row["undecided_because"]
    assert said or row["verdict"] == REPRODUCED
    assert not said or said in tables.findings[-1] or said in " ".join(tables.findings)


@pytest.mark.parametrize("experiment", ["table1", "table2"])
@pytest.mark.parametrize("method", ["tdg", "msmg"])
def test_the_paper_s_experiments_are_of_the_published_setup(experiment, method):
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        cfg = compose("config", [f"+experiment={experiment}", f"method={method}", "scene=Truck"])
    groups = {name: cfg[name] for name in ("budget", "method", "prior", "init", "metrics", "thermal_camera")}
    config = {name: OmegaConf.to_container(part, resolve=True) for name, part in groups.items()}
    config["dataset"] = OmegaConf.to_container(cfg.dataset.loader, resolve=True)
    prior = {"made_from": cfg.prior.made_from}
    record = published(method, config, split="eighty_twenty", prior=prior if method == "tdg" else None)
    assert [departures([record], metric) for metric in ("psnr", "ssim", "lpips")] == [""] * 3
