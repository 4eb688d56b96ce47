import shutil

import numpy as np
from PIL import Image

from tdgbench.present.colours import GUESSED, UNKNOWN, colours_of_levels
from tdgbench.report.panels import error_panel
from tdgbench.report.scene_section import scene_section
from tdgbench.tables.results import read_results


def test_a_scene_shows_the_middle_view_of_every_method_on_one_scale(small_results):
    cells = cells_of(small_results)
    section = scene_section("synthetic", "turntable", cells)
    names = sorted(path.stem for path in (cells[0].folder / "renders").glob("*.png"))
    view = names[len(names) // 2]
    assert section["view"] == view and section["views"] == len(names)
    (group,) = section["groups"]
    psnr = {method["label"]: method["psnr"] for method in group["methods"]}
    of_view = {cell.record.method: cell.read_views()[view]["psnr"] for cell in cells}
    assert psnr == {"MSMG, seed 0": f"{of_view['msmg']:.2f} dB", "TDg, seed 0": f"{of_view['tdg']:.2f} dB"}
    low, high = map(float, group["scale"].ends)
    assert 14 <= low < high <= 50 and group["scale"].unit == " °C"
    as_drawn = [np.array(column.split(), float) * 255 for column in group["tables"]["values"]]
    expected = colours_of_levels("inferno", (low - 14) / 36, (high - 14) / 36)
    assert np.abs(np.transpose(as_drawn) - expected).max() < 0.3
    for cell, method in zip(cells, group["methods"], strict=True):  # what is drawn are the stored values
        stored = cell.pictures(view)
        assert np.array_equal(group["truth"][..., 0], stored.truth[..., 0])
        assert np.array_equal(method["render"][..., 0], stored.render[..., 0])
        assert method["has_gaps"] == (method["depth"] == UNKNOWN).all(-1).any()  # the caption says what gray is
    errors = np.concatenate([cell.pictures(view).error.ravel() for cell in cells])
    assert (errors <= group["scale"].error * 1.05).mean() >= 0.95  # few are beyond the end of the scale


def test_methods_with_another_ground_truth_are_not_laid_over_one_another(small_results, tmp_path):
    experiment = shutil.copytree(small_results, tmp_path / "single")
    for path in experiment.glob("cells/msmg/*/turntable/*/*/t*/*.png"):
        Image.fromarray(np.asarray(Image.open(path)) // 2).save(path)
    groups = scene_section("synthetic", "turntable", cells_of(experiment))["groups"]
    assert [[method["label"] for method in group["methods"]] for group in groups] == [["MSMG, seed 0"], ["TDg, seed 0"]]
    assert groups[0]["scale"].high < groups[1]["scale"].high


def test_it_is_blue_where_the_scores_say_that_the_method_guesses(small_results):
    cells = cells_of(small_results)
    section = scene_section("synthetic", "turntable", cells)
    for cell, method in zip(cells, section["groups"][0]["methods"], strict=True):
        share = cell.read_views()[section["view"]]["barely_seen"]
        assert method["barely_seen"] == f"{100 * share:.0f} %" and 0 < share < 1
        overlay, known = method["guesses"], cell.determinacy(section["view"])
        assert (overlay[..., :3] == GUESSED).all() and np.allclose(overlay[..., 3], 255 * (1 - known), atol=1)


def test_masked_pixels_are_covered_and_named(masked_results):
    cells = cells_of(masked_results)
    section = scene_section("synthetic", "turntable", cells)
    shares = cells[0].record.masked
    assert section["masked"].startswith(
        f"{100 * shares['train']:.1f} % of the training and {100 * shares['test']:.1f} %"
    )
    cover, valid = section["groups"][0]["mask"], cells[0].mask(section["view"])
    assert np.array_equal(cover[..., 3] == 255, ~valid) and np.array_equal(cover[..., 3] == 0, valid)
    assert (cover[~valid][:, :3] == 128).all()
    assert len(section["groups"][0]["errors"]["rows"]) == 1


def test_errors_are_stated_in_degrees():
    counts = np.zeros(511, int)
    counts[[255 + 1, 255 - 4, 255 + 20]] = 60, 36, 4
    (row,) = error_panel({"TDg": counts}, (0.0, 51.0), ["C0"])["rows"]  # a level is 0.2 °C
    (exact,) = error_panel({"TDg": np.eye(1, 511, 255, dtype=int)[0]}, (0.0, 51.0), ["C0"])["rows"]
    assert exact[1:3] == ["< 0.1", "< 0.1"]
    assert row == ["TDg", "0.2", "0.8", "4.0", f"{(60 - 144 + 80) / 100 * 0.2:+.2f}"]


def cells_of(experiment):
    return [cell for cell in read_results(experiment).finished if cell.record.scene == "turntable"]
