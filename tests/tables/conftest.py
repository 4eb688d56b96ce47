"""Tables that several modules look at."""

from __future__ import annotations

import pytest

from tdgbench.tables.build import Tables, build_tables
from tests.helpers.records import published_as_records


@pytest.fixture(scope="session")
def published_tables(tmp_path_factory) -> Tables:
    """The published table as records of one seed, and the tables that are built of them."""
    experiment = tmp_path_factory.mktemp("published")
    published_as_records(experiment)
    return build_tables(experiment)
