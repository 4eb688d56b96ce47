"""`tdgbench view --export`: one file that holds the model, needs nothing else, and renders as the project does."""

from __future__ import annotations

import base64
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tdgbench.scenes.modalities import THERMAL
from tdgbench.view.cells import ViewedCell, open_cell
from tdgbench.view.command import main
from tdgbench.view.export import export
from tdgbench.view.panel import value_text
from tdgbench.view.poses import camera_of, pose_of
from tdgbench.view.renderer import Renderer
from tests.helpers.browser import CHROMIUM, Page, opened

ODD = """</script><script>alert("1")</script> & 'it'"""
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
STILL = "document.body?.dataset.state === 'still'"
PIXELS = """(() => {
  const canvas = document.querySelector("canvas"), gl = canvas.getContext("webgl2");
  const pixels = new Float32Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.FLOAT, pixels);
  return [canvas.width, canvas.height, Array.from(pixels, value => Math.round(value * 1e5) / 1e5)];
})()"""


def exported(cell: ViewedCell, path: Path) -> tuple[str, dict]:
    """The text of the page of a cell, and the facts in it."""
    export(cell, path, 50)
    text = path.read_text(encoding="utf-8")
    return text, json.loads(re.search(r'<script id="facts" type="application/json">(.*?)</script>', text)[1])


@pytest.mark.parametrize("name", ["tdg_folder", "colour_folder"])
def test_the_page_holds_the_model_within_a_step_of_16_bits(name, request, tmp_path):
    cell = open_cell(request.getfixturevalue(name))
    text, facts = exported(cell, tmp_path / "a.html")
    content = base64.b64decode(re.search(r'<script id="gaussians" type="text/plain">(.*?)</script>', text)[1])
    model, count = cell.models[THERMAL], facts["count"]
    rows, columns = -(-count // facts["perRow"]), len(facts["low"])
    means = np.frombuffer(content, "<f4", rows * facts["perRow"] * 3).reshape(-1, 3)
    steps = np.frombuffer(content, "<u2", offset=means.nbytes).reshape(-1, columns)
    assert len(steps) == len(means) and np.array_equal(means[:count], model.means)
    low, high = np.array(facts["low"]), np.array(facts["high"])
    quats = torch.nn.functional.normalize(model.quats, dim=1)
    expected = torch.cat([quats, model.log_scales, model.opacity_logits[:, None], model.sh.flatten(1)], 1).numpy()
    off = np.abs(low + steps[:count] / 65535 * (high - low) - expected)
    assert (off <= (high - low) / 65535 * 0.51 + 1e-7).all() and np.ptp(expected, axis=0).max() > 1
    assert [view["name"].split()[0] for view in facts["views"]] == [*sorted(cell.test), *sorted(cell.train)]
    assert facts["degC"] == (None if cell.degC is None else list(cell.degC))


def test_the_page_is_alone_and_names_are_text(tdg_folder, tmp_path):
    cell = open_cell(tdg_folder)
    folder = replace(cell.cell, record=replace(cell.record, scene=ODD))
    odd = replace(cell, cell=folder, test={ODD: next(iter(cell.test.values()))})
    text, facts = exported(odd, tmp_path / "a.html")
    assert "http://" not in text and "https://" not in text and "default-src 'none'" in text
    assert re.findall(r'(?:src|href)="?([^" >]*)', text) == ["data:,"]
    assert ODD not in text and text.count("<script") == 3 and facts["views"][0]["name"] == f"{ODD} (test)"


def test_what_cannot_be_exported_is_one_line(tdg_folder, msmg_folder, tmp_path, capsys):
    page, cell = tmp_path / "a.html", open_cell(tdg_folder)
    for words, message in (
        ([str(tdg_folder), "--export", str(tmp_path / "record.json")], "the file's name must end in .html"),
        ([str(tdg_folder), str(msmg_folder), "--export", str(page)], "--export takes one folder, not 2"),
        ([str(tdg_folder), "--export", str(tmp_path / "no" / "a.html")], str(tmp_path / "no")),
    ):
        assert main(words) == 1
        out, err = capsys.readouterr()
        assert out == "" and err.startswith("tdgbench view: ") and message in err and err.count("\n") == 1
    with pytest.raises(ValueError, match=r"take 0\.\d MB, more than --max-mb 0; allow --max-mb 1, or train fewer"):
        export(cell, page, 0)
    with pytest.raises(ValueError, match=r"cannot be exported: tdg renders more than Gaussians \(parts.pt\)"):
        export(replace(cell, method=object()), page, 50)
    assert list(tmp_path.iterdir()) == []
    assert main([str(tdg_folder), "--export", str(page)]) == 0
    count = len(cell.models[THERMAL])
    assert capsys.readouterr().out == f"{page}: {count:,} Gaussians, 10 cameras, {page.stat().st_size / 1e6:.1f} MB\n"


def light(page: Page) -> np.ndarray:
    """The composited values (H, W, 4) that the page shows."""
    width, height, values = page.run(PIXELS)
    return np.array(values).reshape(height, width, 4)[::-1]


@pytest.mark.slow
@in_a_browser
@pytest.mark.parametrize(("name", "without"), [("tdg_folder", []), ("colour_folder", ["EXT_float_blend", "Worker"])])
def test_the_page_shows_the_render(name, without, request, tmp_path):
    """From a test view, at both precisions of the device, with and without a worker; the pointer reads °C."""
    cell, path = open_cell(request.getfixturevalue(name)), tmp_path / "a.html"
    text, facts = exported(cell, path)
    path.write_text(text.replace("<head>", f"<head>{lacking(without)}"), encoding="utf-8")
    with opened(path.as_uri(), tmp_path / "profile", 700, 400) as page:
        page.wait_for(STILL, 90)
        shown = light(page)
        height, width = shown.shape[:2]
        camera = camera_of(pose_of(cell.test[min(cell.test)], width / height), width, height)
        expected = Renderer({"": cell}).values("", THERMAL, camera)
        error = np.abs(shown[..., : facts["channels"]] - expected)
        assert expected.std() > 0.03 and error.mean() < 1e-3 and error.max() < 0.02
        page.mouse("moved", width * 0.4, height * 0.6)
        pixel = shown[int(height * 0.6), int(width * 0.4), : facts["channels"]]
        page.wait_for(f"document.querySelector('output').textContent === {value_text(pixel, THERMAL, cell.degC)!r}", 20)
        assert f"{16 if without else 32}-bit floats" in page.run("document.getElementById('precision').textContent")
        assert page.run("performance.getEntriesByType('resource').every(one => one.name.startsWith('blob:'))")
        assert [event for event in page.events if event["method"] == "Runtime.exceptionThrown"] == []


@pytest.mark.slow
@in_a_browser
def test_mouse_keys_and_list_move_the_camera(tdg_folder, tmp_path):
    cell, path = open_cell(tdg_folder), tmp_path / "a.html"
    exported(cell, path)
    with opened(path.as_uri(), tmp_path / "profile", 400, 400) as page:
        page.wait_for(STILL, 90)
        pictures = [light(page)]
        key = "document.querySelector('canvas').dispatchEvent(new KeyboardEvent('keydown', {{ key: {!r} }}))"
        for act in (drag, pinch, *(key.format(name) for name in ("ArrowLeft", "+")), JUMP.format(1), JUMP.format(0)):
            act(page) if callable(act) else page.run(act)
            page.wait_for(STILL, 60)
            pictures.append(light(page))
        changes = [np.abs(after - before).mean() for before, after in itertools.pairwise(pictures)]
        assert min(changes) > 1e-3 and np.array_equal(pictures[0], pictures[-1])


JUMP = "view.selectedIndex = {}, view.dispatchEvent(new Event('change'))"


def drag(page: Page) -> None:
    page.mouse("pressed", 200, 100, buttons=1)
    page.mouse("moved", 230, 110, buttons=1)
    page.mouse("released", 230, 110)


def pinch(page: Page) -> None:
    for kind, reach in (("touchStart", 20), ("touchMove", 30), ("touchMove", 40), ("touchEnd", None)):
        fingers = [] if reach is None else [{"x": 200 + sign * reach, "y": 100, "id": sign + 1} for sign in (-1, 1)]
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)


@pytest.mark.slow
@in_a_browser
def test_a_device_without_floating_point_pictures_is_told(tdg_folder, tmp_path):
    path = tmp_path / "a.html"
    text, _ = exported(open_cell(tdg_folder), path)
    lacks = lacking(["EXT_color_buffer_float", "EXT_color_buffer_half_float"])
    path.write_text(text.replace("<head>", f"<head>{lacks}"), encoding="utf-8")
    with opened(path.as_uri(), tmp_path / "profile") as page:
        words = page.wait_for("document.getElementById('problem')?.textContent", 60)
    assert words.startswith("This device draws no floating-point values (EXT_color_buffer_float)")


def lacking(names: list[str]) -> str:
    """A script that takes WebGL's extensions, or workers, from a page."""
    return f"""<script>{{
      const get = WebGL2RenderingContext.prototype.getExtension, without = {names};
      WebGL2RenderingContext.prototype.getExtension =
        function (name) {{ return without.includes(name) ? null : get.call(this, name); }};
      if (without.includes("Worker")) window.Worker = undefined;
    }}</script>"""
