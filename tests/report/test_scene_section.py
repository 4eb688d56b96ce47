import base64
import io

import numpy as np
from PIL import Image

from tdgbench.report.scene_section import scene_section
from tdgbench.tables.results import read_results


def test_a_scene_shows_the_middle_view_of_every_method(small_results):
    cells = cells_of(small_results)
    section = scene_section("synthetic", "turntable", cells)
    names = sorted(path.stem for path in (cells[0].folder / "renders").glob("*.png"))
    assert section["view"] == names[len(names) // 2]
    assert sorted(method["label"] for method in section["methods"]) == ["MSMG", "TDg"]
    assert section["temperature"] == ["14", "50"] and section["curves"].startswith("<svg")
    psnr = {method["label"]: method["psnr"] for method in section["methods"]}
    scores = {cell.record.method: cell.record.scores["psnr"] for cell in cells}
    assert psnr == {"MSMG": f"{scores['msmg']:.2f} dB", "TDg": f"{scores['tdg']:.2f} dB"}


def test_the_render_is_blue_where_the_scores_say_that_it_guesses(small_results):
    cells = cells_of(small_results)
    section = scene_section("synthetic", "turntable", cells)
    for cell, method in zip(cells, section["methods"], strict=True):
        share = cell.read_views()[section["view"]]["barely_seen"]
        assert method["barely_seen"] == f"{share:.0%}" and 0 < share < 1
        redness = [
            np.mean(pixels[..., 0] - pixels[..., 2].astype(float))
            for pixels in map(shown, (method["render"], method["guesses"]))
        ]
        assert redness[1] < redness[0] - 1


def test_masked_pixels_are_gray_and_named(masked_results):
    cells = cells_of(masked_results)
    section = scene_section("synthetic", "turntable", cells)
    shares = cells[0].record.masked
    assert section["masked"].startswith(
        f"{100 * shares['train']:.1f} % of the training and {100 * shares['test']:.1f} %"
    )
    (method,) = section["methods"]
    valid = cells[0].mask(section["view"])
    for name in ("truth", "error"):
        pixels = shown(method[name])
        assert (pixels[~valid] == 128).all() and not (pixels[valid] == 128).all(axis=1).all(), name
    assert not (shown(method["render"])[~valid] == 128).all()


def shown(uri: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


def cells_of(experiment):
    return [cell for cell in read_results(experiment).finished if cell.record.scene == "turntable"]
