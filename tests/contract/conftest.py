"""The contract suite runs on every backend that is present: virtual, at the wire, and `--bench my.toml`.

Every model of the registry is held to it: the shipped bench has the first model of each kind, and for every
further one a bench with that model is opened, whose device of that kind alone is asked.

On hardware nothing moves but the wheels of the tests marked so; lift the robot, or leave them out with
`-m "not moves"`. `--bench`, `--emulate` and `--hil-seed` are those of the pytest plugin.
"""

import pytest

from hil.procedure.bench_source import BenchSource
from hil.pytest_plugin.selection import plainly, source_of
from hil.vocabulary.errors import DeviceError
from hil.vocabulary.kinds import kinds

SEED = 3
PATIENT = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02}
"""At the wire this computer's load must not count as a servo's silence: the contract is about behaviour."""


def pytest_configure(config):
    config.addinivalue_line("markers", "moves: turns wheels; on hardware the robot must be lifted or held")


def further_models():
    """Those that the shipped bench does not have: (kind, model)."""
    return [(kind.name, model.name) for kind in kinds().values() for model in kind.models[1:]]


def pytest_generate_tests(metafunc):
    if "backend" not in metafunc.fixturenames:
        return
    ways = ["given"] if metafunc.config.getoption("bench") else ["virtual", "wire"]
    if "kind" not in metafunc.fixturenames:
        metafunc.parametrize("backend", ways, scope="module")
        return
    asked = [(way, kind) for way in ways for kind in kinds()]
    if ways != ["given"]:
        asked += [(f"{way} {kind}={model}", kind) for way in ways for kind, model in further_models()]
    metafunc.parametrize(("backend", "kind"), asked, scope="module")


@pytest.fixture(scope="module")
def bench(backend, request):
    """A bench whose world runs and whose devices are still closed."""
    way, _, chosen = backend.partition(" ")
    kind, _, model = chosen.partition("=")
    overrides = {f"{kind}.model": model} if model else {}
    if way == "given":
        source = source_of(request.config)
    elif way == "wire":
        source = BenchSource("emulated", realtime=True, seed=SEED, overrides={**PATIENT, **overrides})
    else:
        source = BenchSource("emulated", seed=SEED, overrides=overrides)
    with plainly():
        try:
            opened = source.open()
        except DeviceError as error:
            if "the extra" not in str(error):
                raise
            pytest.skip(str(error))
    opened.begin()
    yield opened
    opened.close()


@pytest.fixture
def device(kind, bench):
    """One opened device after the other; a device that the bench lacks is skipped by name."""
    found = bench.rig.get(kind)
    if found is None:
        pytest.skip(f"bench {bench.config.name} has no {kind}")
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
