"""What every device promises, of this one: in virtual time, and at the wire in real time."""

from hil.pytest_plugin.contract import *  # noqa: F403

KINDS = ("rangefinder",)
