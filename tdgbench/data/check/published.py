"""Numbers of views that the authors publish, of the paper's scenes.

RGBT-Scenes: camera files in `<Scene>/raw_images/` of the folder that ThermalGaussian's README names (Google Drive
1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg). GlassCup and the dark scene come from a later extension and were not counted.
ThermalMix (Zenodo record 11065834) states "about 60" a scene; its scenes were not counted either.
"""

from __future__ import annotations

VIEWS = {
    "Dimsum": 154,
    "DailyStuff": 78,
    "Ebike": 48,
    "RoadBlock": 71,
    "Truck": 73,
    "RotaryKiln": 106,
    "Parterre": 66,
}
