"""The bench itself: every device at rest for 15 s."""

from hil.pytest_plugin.selfcheck import *  # noqa: F403
