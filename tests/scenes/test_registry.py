import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.registry import DATASETS, GROUPS, SCENES, registered
from tdgbench.tables.published import published_main


def test_scenes_are_those_of_the_published_table():
    table = published_main()
    rows = table[~table["scene"].str.contains("Average")].drop_duplicates("scene")
    assert [(s.name, DATASETS[s.dataset], s.group) for s in SCENES] == list(
        rows[["scene", "dataset", "group"]].itertuples(index=False, name=None)
    )
    assert {s.group for s in SCENES} == set(GROUPS)


def test_aliases(tmp_path):
    for spelling in ("Hand", "hands", "HANDS"):
        assert registered(spelling).name == "Hand"
    assert registered("road_block").name == "RoadBlock"
    (tmp_path / "Hands").mkdir()
    assert registered("Hand").find(tmp_path) == tmp_path / "Hands"
    assert registered("Face").find(tmp_path) is None
    with pytest.raises(SceneError, match="not one of the paper's scenes"):
        registered("Panel")
