"""What every device promises, whoever answers on the wire: the public suite on the shipped devices."""

from hil.pytest_plugin.contract import *  # noqa: F403

OVERRIDES = {"servos.reply_slack_s": 0.02, "servos.retry_budget_s": 0.02}
"""At the wire this computer's load must not count as a servo's silence: the contract is about behaviour."""
