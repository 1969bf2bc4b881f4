"""The contract suite runs on every backend that is present: virtual, at the wire, and `--bench my.toml`.

On hardware nothing moves but the wheels of the tests marked so; lift the robot, or leave them out with
`-m "not moves"`. `--bench`, `--emulate` and `--hil-seed` are those of the pytest plugin.
"""

import pytest


def pytest_configure(config):
    config.addinivalue_line("markers", "moves: turns wheels; on hardware the robot must be lifted or held")


@pytest.fixture
def servos(bench):
    found = bench.rig.servos
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no servos")
    found.open()
    yield found
    found.close()
