import io
import warnings

import pytest
from matplotlib.figure import Figure
from PIL import Image

from tdgbench.present.figures import DPI, any_font, plain, save_figure
from tests.helpers.names import NAMES


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


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_any_name_is_a_title_and_a_label(name):
    figure = Figure(figsize=(2, 1))
    axes = figure.subplots()
    axes.plot([0, 1], label=plain(name))
    axes.set_title(plain(name))
    legend = axes.legend()
    assert len(legend.get_texts()) == 1
    with warnings.catch_warnings(), any_font():
        warnings.simplefilter("error", SyntaxWarning)
        figure.savefig(io.BytesIO(), format="svg")


def test_dollars_are_no_mathematics():
    figure = Figure()
    title = figure.subplots().set_title(plain("$x^2$"))
    assert title._preprocess_math(title.get_text()) == ("$x^2$", False)
