import json

import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry, read_radiometry


def test_radiometry_file(tmp_path):
    path = tmp_path / "temperature.json"
    assert read_radiometry(path) is None
    path.write_text(json.dumps({"min": 16.8, "max": 48.3}))
    assert read_radiometry(path) == Radiometry(TemperatureRange(16.8, 48.3))
    for bad in ('{"min": 3}', '{"min": 5, "max": 4}', "[]", "nonsense"):
        path.write_text(bad)
        with pytest.raises(SceneError, match=r"temperature\.json must hold finite"):
            read_radiometry(path)


@pytest.mark.parametrize(
    "content",
    [
        '{"min": NaN, "max": 3}', '{"min": 1, "max": Infinity}', '{"min": -300, "max": 3}', '{"min": 1, "max": 1e300}',
        '{"min": true, "max": 3}', '{"min": 1, "max": 2, "degC_per_count": NaN}', "null", "[" * 100000,
        '{"min": 1, "max": 2, "degC_per_count": 0}', '{"min": 1, "max": 2, "degC_at_zero": -Infinity}', "\udcff",
        '{"min": 1, "max": 1' + "0" * 5000 + "}",
    ],
    ids=range(12),
)  # fmt: skip
def test_temperatures_that_cannot_be(tmp_path, content):
    path = tmp_path / "temperature.json"
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(SceneError, match=r"temperature\.json must hold finite numbers `min` < `max`"):
        read_radiometry(path)
