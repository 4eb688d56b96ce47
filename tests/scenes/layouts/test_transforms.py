"""Points of nerfstudio's PLY file: read as they are, and refused before a header that lies costs memory."""

from __future__ import annotations

import resource

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.layouts.transforms import read_points


@pytest.mark.parametrize("text", [False, True])
def test_points_and_colours(tmp_path, text):
    kind = [*((axis, "f4") for axis in "xyz"), *((name, "u1") for name in ("red", "green", "blue"))]
    rows = np.array([(0.5, 1, -2, 255, 0, 51), (0, 0.25, 3, 0, 255, 0)], kind)
    PlyData([PlyElement.describe(rows, "vertex")], text=text).write(tmp_path / "points.ply")
    found = read_points(tmp_path / "points.ply")
    assert found.points.tolist() == [[0.5, 1, -2], [0, 0.25, 3]]
    assert np.array_equal(found.colors, np.array([[1, 0, 0.2], [0, 1, 0]], np.float32))


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (("element a.b 1000000000", "property uchar x"), "more than the file has bytes for"),
        (("element vertex 1000000000", "property list uchar int x"), "export points without faces"),
        (("element face 1000000000", "property list uchar int x", "element vertex 0"), "export points without faces"),
        (("element other 0",), "vertex"),
    ],
)
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_header_that_lies(tmp_path, kind, lines, problem):
    path = tmp_path / "points.ply"
    path.write_text("\n".join(["ply", f"format {kind} 1.0", *lines, "end_header", ""]), encoding="ascii")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SceneError, match=rf"points\.ply cannot be read as a point cloud: .*{problem}.*; copy or dow"):
        read_points(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KB
