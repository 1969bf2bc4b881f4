"""What every device promises, emulated and real: the public suite on every model there is."""

import pytest

from hil.core.registry import kinds
from hil.pytest_plugin.contract import *  # noqa: F403
from hil.support.extras import MODULES, is_installed

pytestmark = pytest.mark.usefixtures("warm_commands")

OVERRIDES = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02, "imu.reply_timeout_s": 0.04}
"""At the wire this computer's load must not count as a device's silence: the contract is about behaviour."""
MODELS = tuple(
    (kind.name, model.name)
    for kind in kinds().values()
    for model in kind.models[1:]
    if model.name not in MODULES or is_installed(model.name)
)
"""Those that the shipped bench does not have, as far as what they need is installed."""
