"""The device contract: one suite of checks for emulated and real devices.

`hil accept` runs it and prints findings; the pytest suite `hil.pytest_plugin.contract` runs the same checks
as tests. A check takes the object to check, returns a short text with the measured values, and raises
`Broken`.
"""

from hil.bench.contract.delays import BUSY_SHARE, delays_at_rest, delays_in_motion, idle_for, punctuality
from hil.bench.contract.device_under_test import Broken, Subject, due, judged, oldest_s, read_for
from hil.bench.contract.in_motion import IN_MOTION, without_restart
from hil.bench.contract.interface_promises import AT_REST

__all__ = [
    "AT_REST",
    "BUSY_SHARE",
    "IN_MOTION",
    "Broken",
    "Subject",
    "delays_at_rest",
    "delays_in_motion",
    "due",
    "idle_for",
    "judged",
    "oldest_s",
    "punctuality",
    "read_for",
    "without_restart",
]
