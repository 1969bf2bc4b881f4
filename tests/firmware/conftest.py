"""The node's portable part, compiled once."""

import pytest
from node_on_host import host_library


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    return host_library(tmp_path_factory.mktemp("node"))
