from tdgbench.training.skips import Skips


def test_a_skip_is_taken_where_work_is_needless_and_it_is_allowed():
    skips = Skips(depth=False)
    assert skips.gray.decide(True, "all 40 images are gray", "2 of 3 channels")
    assert (skips.gray.reason, skips.gray.saved) == ("all 40 images are gray", "2 of 3 channels")
    assert not skips.rgb.decide(False, "it trains on RGB", "nothing")
    assert (skips.rgb.taken, skips.rgb.reason, skips.rgb.saved) == (False, "it trains on RGB", "")
    assert not skips.depth.decide(True, "its weight is 0", "half")
    assert (skips.depth.taken, skips.depth.reason, skips.depth.saved) == (False, "switched off", "")


def test_all_skips_have_names():
    skips = Skips().all()
    assert [s.name for s in skips] == ["gray", "rgb", "prior", "depth", "sh", "unseen", "saturated", "plateau"]
    assert all(s.allowed and not s.taken for s in skips)
