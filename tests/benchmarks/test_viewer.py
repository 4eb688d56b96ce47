"""Times are the benchmark's business; here, that its orbit shows the model and that a slow viewer is told."""

import pytest

from benchmarks import viewer
from tdgbench.view.renderer import Look, Renderer
from tests.helpers.command import program_here


def test_every_camera_of_the_orbit_sees_the_model():
    cell = viewer.random_cell(2000, 64, 48)
    cameras = viewer.orbit(cell, 64, 48, 5)
    seen = [Renderer({"": cell}).values("", "alpha", camera).mean() for camera in cameras]
    assert min(seen) > 0.05 and len({camera.center.round(3).tobytes() for camera in cameras}) == 5
    assert viewer.measure(cell, Look(""), cameras)[0] > 0


@pytest.mark.parametrize(("ms", "status"), [(10.0, 0), (70.0, 1)])
def test_fewer_frames_than_needed_end_with_status_1(tmp_path, monkeypatch, ms, status):
    monkeypatch.setattr(viewer, "measure", lambda *_: (ms, 0.0, 2 * ms))
    run = program_here(viewer.main, tmp_path, "viewer", "--count", "50", "--size", "64x48", "--frames", "2")
    assert run.returncode == status, run.stderr
    assert f"= {1000 / ms:.1f} frames/s" in run.stdout and "50 Gaussians, 64x48, depth" in run.stdout


def test_a_trained_cell(small_results, tmp_path, monkeypatch):
    cell = small_results / "cells" / "msmg" / "synthetic" / "turntable" / "colmap" / "seed0"
    monkeypatch.setattr(viewer, "NEEDED", 0.001)
    run = program_here(viewer.main, tmp_path, "viewer", str(cell), "--size", "64x48", "--frames", "2")
    assert run.returncode == 0 and run.stdout.startswith("msmg, 300 Gaussians, 64x48, thermal: render "), run.stderr
