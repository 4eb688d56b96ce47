"""All claims against the published tables, and claims that are not written as they should be."""

import re

import pytest

from tdgbench.tables.claims import CHECKS, claims_table, judge_claims, load_claims
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, ClaimEvidence
from tdgbench.tables.published import published_main


def test_the_published_tables_against_the_words():
    found = claims_table(judge_claims(None)).set_index("id")
    assert set(found.index[found["published"] == FAILS]) == {"psnr-better", "rgbt-better", "bold-follows"}
    assert (found["published"] == HOLDS).sum() == 13
    assert (found["published"] == UNDECIDED).sum() == 27
    assert found.loc[found["published"] == UNDECIDED, "published_seen"].str.startswith("the paper prints no ").all()
    assert "+0.883 %; 0.01 is the fraction" in found.loc["psnr-better", "published_seen"]
    assert "Ebike 0.206 → 0.237" in found.loc["rgbt-better", "published_seen"]
    assert found.loc["bold-follows", "published_seen"] == "Ebike LPIPS, RoadBlock SSIM"
    assert found.loc["thermalmix-within", "published_seen"] == "at most -0.78 at Face"
    assert (found["ours"] == UNDECIDED).all()
    assert "the gain in PSNR is 0.24 dB; over the 7 scenes" in found.loc["better-overall", "published_seen"]
    assert (
        "the 0.012 by which 2 papers' averages of MSMG differ; not sure to be MSMG: thermosplat"
        in found.loc["lpips-better", "published_seen"]
    )
    assert "papers' averages" not in found.loc["time-percent", "published_seen"]


def test_what_is_missing_is_undecided():
    empty = ClaimEvidence(published_main().iloc[:0], None, printed=False)
    found = claims_table(judge_claims(empty)).set_index("id")["ours"]
    assert set(found.drop("bold-follows")) == {UNDECIDED}


def test_every_check_has_a_claim_and_words_with_another_number_than_the_margin_say_what_is_tested():
    assert {claim.check for claim in load_claims()} == set(CHECKS)
    numbers = [claim.said for claim in load_claims() if claim.margins and re.search(r"\d (dB|%)", claim.said)]
    assert len(numbers) == 2 and all("tested is" in said for said in numbers)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("- {id: x, said: y, where: z}", "claim x lacks check"),
        ("- {id: x, said: y, where: z, check: magic}", "claim x names 'magic', which is no check"),
        ("- {id: x, said: y, where: z, check: better, margins: {beauty: 1}}", "lacks reason and names 'beauty'"),
        (
            "- {id: x, said: y, where: z, check: better, methods: [], margins: {psnr: 1}}",
            "x lacks against and lacks reason",
        ),
    ],
)
def test_broken_claims_are_named(tmp_path, wrong, message):
    path = tmp_path / "claims.yaml"
    path.write_text(wrong)
    with pytest.raises(ValueError, match=message):
        load_claims(path)
