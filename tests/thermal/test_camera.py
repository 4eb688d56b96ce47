from dataclasses import replace

import numpy as np
import pytest

from tdgbench.thermal.camera import ViewResponses, normalized


def test_normalization_changes_no_value():
    """Temperatures T' = T scaled and shifted with the normalization give the same values at the reference r."""
    before, r = ViewResponses(np.array([1.0, -2.0, 4.0]), np.array([1.1, 0.9, 1.3])), 20.0
    after, degC = normalized(before), np.linspace(10, 30, 5)[:, None]
    moved = r + before.gains.mean() * (degC - r) + before.offsets.mean()
    assert r + after.gains * (moved - r) + after.offsets == pytest.approx(
        r + before.gains * (degC - r) + before.offsets
    )
    assert after.offsets.mean() == pytest.approx(0) and after.gains.mean() == pytest.approx(1)


def test_the_summary_has_the_unit(drifting_camera):
    assert "°C, gains 0.9" in drifting_camera.summary
    assert "°C" not in replace(drifting_camera, unit="image").summary
