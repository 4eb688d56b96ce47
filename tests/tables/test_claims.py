"""What the paper says in words against its own table, and each check against tables made for it."""

from __future__ import annotations

import pandas as pd
import pytest

from tdgbench.tables.claims import FAILS, HOLDS, UNDECIDED, Evidence, check_all, check_claim, load_claims
from tdgbench.tables.published import published_ablation, published_main
from tdgbench.tables.results import KEYS

PUBLISHED = Evidence(published_main(), published_ablation(), printed=True)
CLAIMS = {claim["id"]: claim for claim in load_claims()}


def changed(scene, metric, method, value, printed=False):
    """The published table with one value changed."""
    table = published_main()
    at = (table["scene"] == scene) & (table["metric"] == metric) & (table["method"] == method)
    assert at.any()
    table.loc[at, "value"] = value
    return Evidence(table, published_ablation(), printed)


def test_the_published_table_against_the_words():
    found = check_all(list(CLAIMS.values()), PUBLISHED, None).set_index("id")
    failing = set(found.index[found["published"] == FAILS])
    assert failing == {"psnr-better", "rgbt-better", "bold-follows"}
    assert "+0.883 %; 0.01 is the fraction" in found.loc["psnr-better", "published_seen"]
    assert "Ebike 0.206 → 0.237" in found.loc["rgbt-better", "published_seen"]
    assert found.loc["bold-follows", "published_seen"] == "Ebike lpips, RoadBlock ssim"
    assert found.loc["thermalmix-within", "published_seen"] == "at most -0.78 at Face"
    assert (found["ours"] == UNDECIDED).all()
    assert "the gain in psnr is 0.24 dB; over the 7 scenes" in found.loc["better-overall", "published_seen"]
    assert "smaller than the 0.012 between papers" in found.loc["lpips-better", "published_seen"]
    assert "2 of 7 gains are larger" in found.loc["rgbt-better", "published_seen"]
    assert "between papers" not in found.loc["time-percent", "published_seen"]


@pytest.mark.parametrize(
    ("claim", "scene", "metric", "method", "value", "verdict"),
    [
        ("psnr-better", "Average (Overall)", "psnr", "tdg", 27.1827, HOLDS),
        ("ssim-better", "Average (Overall)", "ssim", "tdg", 0.8950, FAILS),
        ("lpips-better", "Average (Overall)", "lpips", "tdg", 0.180, FAILS),
        ("psnr-averages", "Average (Overall)", "psnr", "msmg", 27.30, FAILS),
        ("better-overall", "Average (Overall)", "lpips", "tdg", 0.178, FAILS),
        ("time-minutes", "Average (Overall)", "hours", "tdg", 0.20, FAILS),
        ("time-percent", "Average (Overall)", "hours", "tdg", 0.20, FAILS),
        ("faster-everywhere", "Lion", "hours", "tdg", 9.0, FAILS),
        ("thermalmix-within", "Lion", "psnr", "tdg", 1.0, FAILS),
        ("averages-follow", "Lion", "psnr", "tdg", 1.0, FAILS),
        ("bold-follows", "Lion", "psnr", "tdg", 99.0, FAILS),
    ],
)
def test_each_check_can_turn(claim, scene, metric, method, value, verdict):
    assert check_claim(CLAIMS[claim], changed(scene, metric, method, value)).verdict == verdict


def test_random_points():
    ablation = published_ablation()
    ablation.loc[(ablation["method"] == "tdg") & (ablation["init"] == "random"), "value"] = 25.0
    found = check_claim(CLAIMS["random-fails"], Evidence(published_main(), ablation, True))
    assert found.verdict == FAILS and "tdg loses 2.42 dB" in found.seen
    assert check_claim(CLAIMS["random-fails"], Evidence(published_main(), None, True)).verdict == UNDECIDED


def test_what_is_missing_is_undecided():
    empty = Evidence(published_main().iloc[:0], None, printed=False)
    found = check_all(list(CLAIMS.values()), PUBLISHED, empty).set_index("id")["ours"]
    assert set(found.drop("bold-follows")) == {UNDECIDED}
    one = published_main().query("scene == 'Lion'")
    assert list(one.columns[: len(KEYS)]) == KEYS
    found = check_claim(CLAIMS["thermalmix-within"], Evidence(pd.DataFrame(one), None, printed=False))
    assert found.verdict == HOLDS


@pytest.mark.parametrize("wrong", ["- {id: x, said: y, where: z}", "- {id: x, said: y, where: z, check: magic}"])
def test_broken_claims_are_named(tmp_path, wrong):
    path = tmp_path / "claims.yaml"
    path.write_text(wrong)
    with pytest.raises(ValueError, match="claim x"):
        load_claims(path)
