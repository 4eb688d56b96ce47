import numpy as np
from PIL import Image

from tdgbench.bench.paths import cell_folder_of
from tdgbench.report.strip import draw_strip
from tests.helpers.records import record


def test_draws_what_is_done(tmp_path):
    assert not draw_strip([record(status="failed")], tmp_path, tmp_path / "strip.png")
    done = record(scores={"psnr": 12.0})
    for sub in ("renders", "targets"):
        folder = cell_folder_of(tmp_path, done) / sub
        folder.mkdir(parents=True)
        Image.fromarray(np.full((30, 40), 90, np.uint8)).save(folder / "v.png")
    assert draw_strip([done], tmp_path, tmp_path / "strip.png")
    with Image.open(tmp_path / "strip.png") as picture:
        assert picture.width > picture.height > 100
