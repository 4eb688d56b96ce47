import pytest

from tests.helpers.models import write_models


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    """A model in each format of tests.helpers.models; only to be read."""
    return write_models(tmp_path_factory.mktemp("models"))
