"""For the tests of recordings: the topic mapping of another robot's bag."""

import pytest
from mcap_cases import MAPPING


@pytest.fixture
def topics(tmp_path):
    path = tmp_path / "topics.toml"
    path.write_text(MAPPING)
    return path
