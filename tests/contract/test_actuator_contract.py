"""What the servos promise, emulated and real: those checks of `hil accept` that move."""

import pytest

from hil.bench.contract import IN_MOTION
from hil.pytest_plugin.contract import closed_bench, pytest_generate_tests  # noqa: F401

pytestmark = [pytest.mark.moves, pytest.mark.usefixtures("warm_commands")]
OVERRIDES = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02}
"""At the wire this computer's load must not count as a servo's silence: the contract is about behaviour."""


@pytest.fixture
def bench(closed_bench):
    """The suite's, whose devices the tests open."""
    return closed_bench


@pytest.mark.parametrize("promise", IN_MOTION)
def test_servos_keep(promise, servos, bench):
    IN_MOTION[promise](bench)
