"""The end of a sweep: failed cells among good ones, a report that cannot be written."""

import shutil

from tdgbench.experiments.sweep import finish
from tests.helpers.command import command_here
from tests.helpers.configs import QUICK


def test_a_failure_is_one_line_at_the_end_and_the_other_results_are_complete(tmp_path, small_scene, small_gray_scene):
    root = tmp_path / "captures"
    for name, scene in (("good", small_scene), ("spoiled", small_scene), ("gray", small_gray_scene)):
        shutil.copytree(scene.train[0].thermal_path.parents[1], root / name)
    (root / "spoiled" / "thermal" / "view004.png").write_bytes(b"broken")
    shutil.rmtree(root / "gray" / "rgb")
    run = command_here(
        tmp_path, "-m", "dataset=folder", f"data.root={root}", "scene=good,spoiled,gray", "method=msmg",
        "budget=demo", "budget.iterations=10", "metrics.lpips.download=false",
    )  # fmt: skip
    assert run.returncode == 1 and "Traceback" not in run.stderr
    assert "1 cell run, 0 already there, 2 failed" in run.stdout
    failed = [line for line in run.stdout.splitlines() if line.startswith("failed:")]
    assert sum("view004.png cannot be read" in line for line in failed) == 1
    assert sum("has no RGB image" in line for line in failed) == 1
    assert (tmp_path / "results" / "single" / "strip.png").exists()


def test_a_report_that_cannot_be_written_is_an_error(tmp_path, data_root):
    (tmp_path / "results" / "single" / "report.html").mkdir(parents=True)  # in the way
    run = command_here(tmp_path, "method=3dgs", "scene=turntable", f"data.root={data_root}", *QUICK)
    assert run.returncode == 1
    assert "1 cell run" in run.stdout and "error: cannot write tables and report: [Errno 21]" in run.stdout


def test_outputs_are_made_again_only_if_something_changed(tmp_path, small_results, capsys, monkeypatch):
    experiment = tmp_path / "small"
    shutil.copytree(small_results, experiment, ignore=shutil.ignore_patterns("tables", "report.html", "strip.png"))
    calls, make = [], finish._write_outputs
    monkeypatch.setattr(finish, "_write_outputs", lambda folder: calls.append(folder) or make(folder))
    findings = finish.write_all(experiment)
    printed = capsys.readouterr().out
    assert finish.write_all(experiment) == findings and capsys.readouterr().out == printed and len(calls) == 1
    record = next(experiment.rglob("cells/**/record.json"))
    main = experiment / "tables" / "main.csv"
    before = main.read_bytes()
    for i, change in enumerate(
        (
            lambda: record.write_bytes(record.read_bytes() + b"\n"),
            lambda: main.write_text("metric\n"),
            lambda: (experiment / "report.html").unlink(),
            lambda: (experiment / "tables" / finish.MADE).write_text('{"printed": "\\u001b[2J"}'),
        )
    ):
        change()
        assert finish.write_all(experiment) == findings and len(calls) == 2 + i and main.read_bytes() == before
    made = experiment / "tables" / finish.MADE
    made.write_text(made.read_text().replace('"printed": "', '"printed": "\\u001b[2J'))
    finish.write_all(experiment)  # what a terminal would obey is not printed
    assert len(calls) == 6 and "\x1b[2J" not in capsys.readouterr().out
