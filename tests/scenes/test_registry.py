import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.registry import DATASETS, GROUPS, SCENES, registered, sensor_of
from tdgbench.tables.published import published_main


def test_scenes_are_those_of_the_published_table():
    table = published_main()
    rows = table[~table["scene"].str.contains("Average")].drop_duplicates("scene")
    assert [(s.name, DATASETS[s.dataset], s.group) for s in SCENES] == list(
        rows[["scene", "dataset", "group"]].itertuples(index=False, name=None)
    )
    assert {s.group for s in SCENES} == set(GROUPS)


def test_sensors_are_known_of_the_scenes_whose_authors_state_them():
    ten = {"Building", "DailyStuff", "Dimsum", "Ebike", "IronIngot", "LandScape", "Parterre", "RoadBlock", "RotaryKiln",
           "Truck"}  # of the data set as published; others were added to it later  # fmt: skip
    known = {s.name for s in SCENES if sensor_of(DATASETS[s.dataset], s.name)}
    assert known == ten & {s.name for s in SCENES} and sensor_of("ThermalMix", "Truck") == {}
    assert sensor_of("RGBT-Scenes", "Truck")["sensor"].startswith("240×180 px")


def test_aliases(tmp_path):
    for spelling in ("Hand", "hands", "HANDS"):
        assert registered(spelling).name == "Hand"
    assert registered("road_block").name == "RoadBlock"
    (tmp_path / "Hands").mkdir()
    assert registered("Hand").find(tmp_path) == tmp_path / "Hands"
    assert registered("Face").find(tmp_path) is None
    with pytest.raises(SceneError, match="not one of the paper's scenes"):
        registered("Panel")
