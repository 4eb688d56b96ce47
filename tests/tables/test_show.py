from __future__ import annotations

import re
import subprocess
import sys

from tdgbench.children import with_path
from tdgbench.scenes.registry import SCENES
from tdgbench.tables.build import TableOptions, build_tables
from tdgbench.tables.show import show_tables
from tests.helpers.paths import ROOT
from tests.helpers.records import published_as_records, write


def test_prints_numbers_reasons_and_differences(tmp_path, capsys):
    write(tmp_path, scores={"lpips": None}, missing={"lpips": "no backbone"})
    show_tables(build_tables(tmp_path))
    text = capsys.readouterr().out
    assert "20.00" in text and "0:06:00" in text and "no backbone" in text
    assert "3 of 136 published numbers" in text and "psnr: ours − published -6.280" in text
    assert "1 undecided (unknown for 1)" in text
    assert "found:" not in text  # `show_findings` comes later
    assert "scenes that are not on disk: `tdgbench data get rgbt_scenes data` and" in text
    show_tables(build_tables(tmp_path, TableOptions(("psnr_true",))))
    text = capsys.readouterr().out
    assert "no backbone" not in text and "n/a: PSNR to true temperatures, dB" in text


def test_a_pipe_gets_every_name_and_number_and_the_findings_last(tmp_path):
    """Where there is no terminal, neither rich's 80 columns nor those of the shell cut the names of the scenes."""
    for seed in range(2):
        published_as_records(tmp_path, seed)
    environment = {**with_path(ROOT), "PYTHONIOENCODING": "utf-8", "COLUMNS": "40"}
    run = subprocess.run(
        [sys.executable, "-m", "tdgbench", "tables", str(tmp_path)],
        env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert run.returncode == 0 and "…" not in run.stdout, run.stderr
    rows = re.findall(r"^│ (\S[^│]*?) +│ MSMG +│(.*)│$", run.stdout, re.MULTILINE)
    assert [name for name, _ in rows if "Average" not in name] == [scene.name for scene in SCENES]
    score, time = r" *[\d.]+ ± [\d.]+ │", r" +\d:\d\d:\d\d ± [\d.]+ s "  # the paper has no scores of right halves
    assert all(re.fullmatch(f"{score} +n/a │({score}){{2}}{time}", numbers) for _, numbers in rows)
    assert run.stdout.splitlines()[-1] == "found: 102 of 102 published scores reproduced"
