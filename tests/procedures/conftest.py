"""No test of a procedure reads the topics of its recording."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def without_topics(cycles_alone):
    """Of what a procedure records, its figures and its replay need the cycles alone."""
