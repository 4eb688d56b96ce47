from io import StringIO

from rich.console import Console

from tdgbench.bench.progress import CellProgress
from tdgbench.training.loop import LogLine


def test_shows_loss_psnr_and_count():
    out = StringIO()
    progress = CellProgress(Console(file=out, force_terminal=True, width=160), 100)
    progress.begin("tdg on a/b")
    progress.rename("tdg on a/c")
    progress.stage("prior")
    progress.count(3, 9)
    progress.stage("train")
    progress.line(LogLine(50, 1.0, 0.1234, 27.5, 12345, {}))
    progress.end()
    text = out.getvalue()
    assert "tdg on a/c" in text and "loss 0.1234" in text and "27.5 dB" in text and "12,345 Gaussians" in text
