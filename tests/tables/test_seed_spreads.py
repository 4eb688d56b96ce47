import pandas as pd
import pytest

from tdgbench.tables.seed_spreads import usual_spread

MEASURED = (
    "the largest standard deviation over seeds that was measured on {} from sparse points, of some method and "
    "budget, is 1.7 dB PSNR (docs/findings/verdicts.md)"
)


@pytest.mark.parametrize(
    ("scenes", "std", "words"),
    [
        (["orbit"], float("nan"), MEASURED.format("orbit")),
        (["orbit", "attic"], float("nan"), MEASURED.format("these scenes")),
        (["orbit"], 0.25, "a method's standard deviation over seeds here on orbit is up to 0.25 dB PSNR"),
    ],
)
def test_usual_spread(scenes, std, words):
    assert usual_spread(pd.DataFrame({"metric": "psnr", "dataset": "synthetic", "scene": scenes, "std": std})) == words
