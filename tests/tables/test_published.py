"""The published numbers: complete, and consistent with themselves; others' with their sources, under our names."""

import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.registry import DATASETS, registered
from tdgbench.tables.measures import KEYS, MAIN_COLUMNS, OVERALL
from tdgbench.tables.published import PAPER, load_sources, published_elsewhere, published_main


# The paper's marks that do not follow from its numbers: none at Ebike LPIPS, and TDg at the tie of Road Block SSIM.
def test_every_cell_is_there():
    table = published_main()
    assert len(table) == 2 * 4 * (14 + 3)
    assert table["value"].notna().all() and not table.duplicated(KEYS).any()
    assert set(table["metric"]) == set(MAIN_COLUMNS) and set(table["method"]) == {"msmg", "tdg"}


@pytest.mark.parametrize(
    ("method", "scene", "metric", "value"),
    [("msmg", "Dimsum", "psnr", 26.80), ("tdg", "Ebike", "lpips", 0.237), ("msmg", "RotaryKiln", "psnr", 26.80),
     ("tdg", "Lion", "ssim", 0.992), ("tdg", "Face", "train_hours", 0.102), ("msmg", "DarkScenes", "ssim", 0.811),
     ("tdg", "GlassCup", "psnr", 25.66), ("msmg", "Hand", "lpips", 0.246), ("tdg", OVERALL, "ssim", 0.8899)],
)  # fmt: skip
def test_spot_checks(method, scene, metric, value):
    table = published_main()
    found = table[(table["method"] == method) & (table["scene"] == scene) & (table["metric"] == metric)]
    assert found["value"].tolist() == [value]


def test_every_number_of_others_has_its_source():
    table, sources = published_elsewhere(), load_sources()
    assert set(table["source"]) == {name for name, s in sources.items() if s["file"] == "others.csv"}
    assert sources[PAPER]["file"] == "table1.csv" and all(s["title"] and s["where"] for s in sources.values())
    assert not table.duplicated(["source", "printed_as", "scene", "metric"]).any()
    assert len(table) == 5 * 3 * 11 + 9 and table["value"].notna().all()
    for name, source in sources.items():  # an entry for a method that is not printed would be a typing error
        assert set(source["methods"]) <= set(table[table["source"] == name]["printed_as"])
        assert all(set(entry) == {"as", "sure", "note"} for entry in source["methods"].values())


def test_scenes_of_others_have_our_names():
    table = published_elsewhere()
    assert set(table["dataset"]) <= set(DATASETS.values())
    not_in_the_paper = {"Building", "IronIngot", "LandScape", "Average"}
    for scene in set(table["scene"]) - not_in_the_paper:
        assert registered(scene).name == scene
    for scene in not_in_the_paper:
        with pytest.raises(SceneError):
            registered(scene)


@pytest.mark.parametrize(
    ("source", "printed_as", "method", "scene", "metric", "value"),
    [("thermosplat-2601", "thermalgaussian", "msmg", "Parterre", "psnr", 26.16),
     ("thermosplat-2601", "3dgs", "3dgs", "Truck", "ssim", 0.863),
     ("thermosplat-2601", "mmone", "mmone", "RotaryKiln", "lpips", 0.17),
     ("cegs-readme", "ommg", "ommg", "Average", "psnr", 25.64)],
)  # fmt: skip
def test_spot_checks_of_others(source, printed_as, method, scene, metric, value):
    table = published_elsewhere().set_index(["source", "printed_as", "scene", "metric"])
    row = table.loc[(source, printed_as, scene, metric)]
    assert row["value"] == value and row["method"] == method
