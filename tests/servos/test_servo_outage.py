"""A servo may be of no use for as long as `fail_after_s` says, and not a nanosecond longer."""

import pytest

from hil.config.servos import ServosConfig
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.servos.dynamixel.answer_timeouts import AnswerTimeouts

LIMIT_NS = 500_000_000


def noted(status, *times_ns, alert=0):
    """Joint 2 has this status at these times, the others answer."""
    watch = AnswerTimeouts(ServosConfig(fail_after_s=LIMIT_NS * 1e-9), "servos", 0)
    statuses, alerts = [Status.OK] * 8, [0] * 8
    statuses[2], alerts[2] = status, alert
    for t_ns in times_ns:
        watch.note(tuple(statuses), alerts, t_ns)


def test_the_limit_is_where_it_is_said_to_be():
    noted(Status.TIMEOUT, LIMIT_NS)
    with pytest.raises(
        DeviceTimeoutError, match=r"nothing usable for 0\.5 s from drive_BR \(ID 3\): timeout"
    ):
        noted(Status.TIMEOUT, LIMIT_NS, LIMIT_NS + 1)


def test_time_between_two_runs_counts_for_no_servo_whatever_was_sent_then():
    """The bus is kept alive by writes: a reply that is late after two seconds is one lost read."""
    read_ns, run_ns = 10_000_000, 400_000_000
    before, pause_ns = range(read_ns, run_ns // 2, read_ns), 4 * LIMIT_NS
    after = range(before[-1] + pause_ns, before[-1] + pause_ns + LIMIT_NS - before[-1], read_ns)
    noted(Status.TIMEOUT, *before, *after)
    with pytest.raises(DeviceTimeoutError):
        noted(Status.TIMEOUT, *before, *after, after[-1] + read_ns, after[-1] + 2 * read_ns)


def test_a_broken_servo_among_silent_ones_is_what_has_to_be_mended():
    watch = AnswerTimeouts(ServosConfig(fail_after_s=LIMIT_NS * 1e-9), "servos", 0)
    status = (Status.TIMEOUT, Status.HARDWARE_ERROR, *[Status.OK] * 6)
    watch.note(status, [0, 0x20, *[0] * 6], LIMIT_NS // 2)
    with pytest.raises(DeviceError, match=r"drive_FL \(ID 1\): timeout, drive_BL .*reboot") as error:
        watch.note(status, [0, 0x20, *[0] * 6], LIMIT_NS + 1)
    assert not isinstance(error.value, DeviceTimeoutError)
