import pytest

from tdgbench.scenes.options import split_names

NAMES = [f"v{i:02d}" for i in range(20)]


def test_eighty_twenty():
    train, test = split_names(NAMES[::-1], "eighty_twenty", {})
    assert test == ["v00", "v05", "v10", "v15"] and len(train) == 16 and not set(train) & set(test)


def test_every_8th():
    assert split_names(NAMES, "every_8th", {})[1] == ["v00", "v08", "v16"]


def test_as_shipped():
    shipped = {name: "test" if name in ("v03", "v04") else "train" for name in NAMES}
    train, test = split_names(NAMES, "folder", shipped)
    assert test == ["v03", "v04"] and len(train) == 18


def test_impossible_splits_are_refused():
    with pytest.raises(ValueError, match="needs train/ and test/"):
        split_names(NAMES, "folder", {})
    with pytest.raises(ValueError, match="0 training and 1 test"):
        split_names(["only"], "every_8th", {})
    with pytest.raises(ValueError, match="split is 'half'"):
        split_names(NAMES, "half", {})
