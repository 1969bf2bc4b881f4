"""The contract suite runs on every backend that is present: virtual, at the wire, and `--bench my.toml`.

On hardware nothing moves but the wheels of the tests marked so; lift the robot, or leave them out with
`-m "not moves"`. `--bench`, `--emulate` and `--hil-seed` are those of the pytest plugin.
"""

from pathlib import Path

import pytest

IN_REAL_TIME = (
    "test_a_read_never_waits_for_the_next_sample",
    "test_a_sample_is_delivered_once",
    "test_it_can_be_opened_again",
    "test_it_loses_next_to_nothing",
    "test_servos_keep",
)
"""What is asked at the wire by default, of the shipped bench; all of it, of every model, in the long run."""


def pytest_collection_modifyitems(items):
    for item in items:
        name, _, parameters = item.name.partition("[")
        asked = name in IN_REAL_TIME and not parameters.startswith("wire ")
        if parameters.startswith("wire") and not asked and Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.long)


def pytest_configure(config):
    config.addinivalue_line("markers", "moves: turns wheels; on hardware the robot must be lifted or held")


@pytest.fixture
def servos(bench):
    found = bench.devices.servos
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no servos")
    found.open()
    yield found
    found.close()
