import pytest
from matplotlib.figure import Figure
from PIL import Image

from tdgbench.report.figures import DPI, save_figure


def test_a_figure_is_written_whole_or_not_at_all(tmp_path):
    target = tmp_path / "figure.png"
    save_figure(Figure(figsize=(2, 1)), target)
    assert Image.open(target).size == (2 * DPI, DPI)

    class Broken(Figure):
        def savefig(self, path, **options):
            path.write_bytes(b"half of it")
            raise OSError("the disk is full")

    before = target.read_bytes()
    with pytest.raises(OSError, match="full"):
        save_figure(Broken(), target)
    assert target.read_bytes() == before and list(tmp_path.iterdir()) == [target]
