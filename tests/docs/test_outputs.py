"""README, tutorial and report page show what their commands print (docs/outputs.py)."""

from __future__ import annotations

import re
import runpy
from types import SimpleNamespace

import pytest

from tests.helpers.paths import ROOT

OUTPUTS = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "outputs.py")))
PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in OUTPUTS.PAGES}


@pytest.mark.parametrize("name", PAGES)
def test_every_output_has_a_command_and_decimals_in_the_text_are_of_an_output(name):
    commands = 0
    for block in OUTPUTS.blocks(PAGES[name]):
        commands += block.language == "sh" and "not run" not in block.notes
        assert block.language or ((commands or "output" in block.notes) and block.text), block
    shown = "".join(block.text for page in PAGES.values() for block in OUTPUTS.blocks(page))
    text = re.sub(r"^```.*?^```$|<!--.*?-->", "", OUTPUTS.MADE.sub("", PAGES[name]), flags=re.MULTILINE | re.DOTALL)
    rounded = {f"{float(number):.{digits}f}" for number in re.findall(r"\d+\.\d+", shown) for digits in (2, 3)}
    if name != "README.md":
        numbers = re.findall(r"\d+\.\d\d+(?!\.\d)", text)
        assert [number for number in numbers if number not in shown and number not in rounded] == []


def test_what_is_printed_before_the_first_training(capsys):
    assert OUTPUTS.main(check=True, untrained=True) == 0, capsys.readouterr().out


@pytest.mark.slow
def test_what_is_printed(capsys):
    assert OUTPUTS.main(check=True, untrained=False) == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    "here, old, new, lines",
    [
        (True, "PSNR 40.10, in 0:00:20", "PSNR  40.10, in 0:01:20", 0),
        (True, "PSNR 40.10", "PSNR 40.11", 3),
        (False, "PSNR 40.10, SSIM 0.990", "PSNR 40.35, SSIM 0.986", 0),
        (False, "PSNR 40.10, SSIM 0.990", "PSNR 40.10, SSIM 0.984", 3),
        (False, "PSNR 40.10", "PSNR 40.41", 3),
        (False, "found: TDg is better", "found: undecided", 0),
        (False, "7 cells", "8 cells", 3),
        (False, "a", "a\nb", 2),
    ],
)
def test_what_may_differ(here, old, new, lines):
    made = f"Made on 2026-01-01 with tdgbench 0.1.0: {OUTPUTS.machine() if here else 'another machine'}.\n"
    assert len(OUTPUTS.differences(made + old, made.replace("01-01", "02-02") + new)) == lines


def test_outputs_replace_their_blocks(tmp_path):
    page = "```sh\necho a; echo b >&2\n```\n\n<!-- lines: b -->\n```\n```\n<!-- output: echo c -->\n```\nx\n```\n"
    wanted = page.replace("-->\n```\n", "-->\n```\nb\n", 1).replace("x\n", "c\n")
    assert OUTPUTS.remade(page, tmp_path) == wanted
    with pytest.raises(RuntimeError, match="ends with status 3:\nsad"):
        OUTPUTS.remade("```sh\necho sad; exit 3\n```\n```\n```\n", tmp_path)
