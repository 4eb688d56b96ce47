from collections.abc import Callable

import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, Scene


@pytest.fixture
def load() -> Callable[..., Scene]:
    """Load the scene in a folder. layout: of the data set; by default it is detected."""

    def act(folder, layout=None, **options) -> Scene:
        return FolderDataset(str(folder), ReadOptions(**options), layout).load(None)

    return act
