"""Checks that a device loses no samples and does not restart while it is watched, by the limit of `bring_up`.

Late samples are not lost. In real time a device may be watched several times, and the best time counts; if
this computer is too busy, missing samples do not count against the device.
"""

from hil.bench.contract.delays import BUSY_SHARE, idle_for
from hil.bench.contract.device_under_test import SHARE, Broken, Subject, due, read_for
from hil.core.registry import kinds
from hil.core.signals import Status, worst
from hil.drivers.doctor_watch import SUPPLY, restarted

_SETTLE_S, _WATCH_S, _TIMES, _IDLE_S = 0.6, 2.0, 3, 1.0
_AT_THE_ENDS = 1


def loses_next_to_nothing(subject: Subject) -> str:
    """Check that as many of the due samples are good as `bring_up` asks for, and that none reports a restart.

    Counting begins after a start-up time of the device, as in the doctor.
    """
    limit, real_time = kinds()[subject.kind].min_delivered, subject.anew is None
    share, message = 0.0, ""
    for _ in range(_TIMES if real_time else 1):
        good, wanted = _watched(subject)
        if not message or good / (wanted - _AT_THE_ENDS) > share:
            share, message = good / (wanted - _AT_THE_ENDS), f"{good} of {wanted:.0f} due are good"
        if share >= limit:
            return message
    if real_time and share >= SHARE:
        idle = idle_for(subject.bench.config, _IDLE_S)
        if idle.late > BUSY_SHARE * idle.cycles:
            return f"{message}; this computer is too busy to say whether the others were lost"
    raise Broken(
        f"{message} ({share:.0%})",
        f"{limit:.0%} or more in {_WATCH_S:g} s, as bring_up asks for",
        "check cable, plugs, termination and supply; `hil doctor` says more",
    )


def _watched(subject: Subject) -> tuple[int, float]:
    """Numbers of good and of due samples in one observation."""
    with subject.opened() as device:
        read_for(subject.bench, device, _SETTLE_S)
        samples = read_for(subject.bench, device, _WATCH_S)
    states = [worst(s) for s in samples]
    if again := restarted(states.count(Status.RESET), len(states)):
        raise Broken(again, "none", SUPPLY)
    wanted = due(subject.bench, subject.kind, samples, _WATCH_S)
    return states.count(Status.OK), max(_AT_THE_ENDS + 1.0, wanted)
