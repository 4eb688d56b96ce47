from tdgbench.splats.columns import COLORS_AT, padded


def test_rows_are_whole_cache_lines():
    assert [padded(COLORS_AT + k) for k in (1, 4, 16, 48)] == [16, 16, 32, 64]
