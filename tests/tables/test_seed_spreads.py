import pandas as pd
import pytest

from tdgbench.tables.seed_spreads import usual_spread

MEASURED = "1.7 dB PSNR apart (standard deviation, docs/findings/verdicts.md)"


@pytest.mark.parametrize(
    ("scenes", "std", "words"),
    [
        (["orbit"], float("nan"), f"seeds of orbit were up to {MEASURED}"),
        (["orbit", "attic"], float("nan"), f"seeds of these scenes were up to {MEASURED}"),
        (["orbit"], 0.25, "here seeds of orbit are up to 0.25 dB PSNR apart (standard deviation)"),
    ],
)
def test_usual_spread(scenes, std, words):
    assert usual_spread(pd.DataFrame({"metric": "psnr", "dataset": "synthetic", "scene": scenes, "std": std})) == words
