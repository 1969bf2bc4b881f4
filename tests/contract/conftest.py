"""The contract suite runs on every backend that is present: virtual, at the wire, and `--bench my.toml`.

On hardware nothing moves but the wheels of the tests marked so; lift the robot, or leave them out with
`-m "not moves"`. `--bench`, `--emulate` and `--hil-seed` are those of the pytest plugin.
"""

import pytest

from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin.selection import plainly, source_of
from hil.vocabulary.kinds import kinds

SEED = 3
PATIENT = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02}
"""At the wire this computer's load must not count as a servo's silence: the contract is about behaviour."""


def pytest_configure(config):
    config.addinivalue_line("markers", "moves: turns wheels; on hardware the robot must be lifted or held")


def pytest_generate_tests(metafunc):
    if "backend" in metafunc.fixturenames:
        given = metafunc.config.getoption("bench")
        metafunc.parametrize("backend", ["given"] if given else ["virtual", "wire"], scope="module")


@pytest.fixture(scope="module")
def bench(backend, request):
    """A bench whose world runs and whose devices are still closed."""
    if backend == "given":
        source = source_of(request.config)
    elif backend == "wire":
        source = BenchSource("emulated", realtime=True, seed=SEED, overrides=PATIENT)
    else:
        source = BenchSource("emulated", seed=SEED)
    with plainly():
        opened = source.open()
    opened.begin()
    yield opened
    opened.close()


@pytest.fixture(params=tuple(kinds()))
def device(request, bench):
    """One opened device after the other; a device that the bench lacks is skipped by name."""
    found = bench.rig.get(request.param)
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no {request.param}")
    found.open()
    yield found
    found.close()


@pytest.fixture
def servos(bench):
    found = bench.rig.servos
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no servos")
    found.open()
    yield found
    found.close()


@pytest.fixture(scope="module")
def collect(bench):
    """Read a device at the loop rate for a while."""

    def run(device, duration_s):
        period_ns = round(1e9 / bench.config.loop.rate_hz)
        samples, next_ns = [], bench.clock.now_ns()
        for _ in range(round(duration_s * bench.config.loop.rate_hz)):
            samples += device.read()
            next_ns += period_ns
            bench.clock.sleep_until_ns(next_ns)
        return samples

    return run
