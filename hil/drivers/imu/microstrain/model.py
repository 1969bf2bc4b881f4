"""MicroStrain (HBK) 3DM-CV7 and 3DM-GV7 on a serial port, which speak the public MIP protocol.

It is supported beside the BNO055, which is no longer made, because it is on sale, its maker publishes the
protocol and an SDK under the MIT licence, and one packet holds attitude, rates, linear acceleration, gravity,
the filter's state and the sensor's own time, from 100 to 1000 times a second.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

from hil.config.microstrain import MicrostrainConfig
from hil.core.finding import Finding, Level
from hil.core.signals import Status
from hil.drivers.doctor_watch import LOSS_FAILURE, LOSS_WARNING, Watched
from hil.drivers.serial_and_can_models import SerialModel
from hil.links.mip import fields as f

if TYPE_CHECKING:
    from hil.drivers.imu.microstrain.driver import MicrostrainImu

_LOST_PERIODS = 1.5
_RATE_SHARE = 0.03
_LATE_S = 0.03


def look(watched: Watched) -> Iterator[Finding]:
    """Findings on the sensor's filter, its rate and its late samples."""
    imu: MicrostrainImu = watched.device
    if imu.latest is not None:
        yield _filter(imu.latest)
    good = [s for s in watched.samples if s.status is Status.OK]
    if len(good) < 2:
        return
    period_s = [1e-9 * (b.stamp.device_ns - a.stamp.device_ns) for a, b in pairwise(good)]
    lost = sum(p * imu.rate_hz > _LOST_PERIODS for p in period_s)
    usual_hz = 1.0 / sorted(period_s)[len(period_s) // 2]
    right = abs(usual_hz - imu.rate_hz) < _RATE_SHARE * imu.rate_hz
    yield Finding(
        "imu",
        "rate",
        "ok" if right and not lost else "warning",
        f"{usual_hz:.1f} Hz, {lost} gaps",
        f"{imu.rate_hz:.1f} Hz without gaps",
        "set the adapter's latency timer to 1 ms; raise the baud rate",
    )
    due_s = watched.config.delay_s + 1.0 / watched.loop_hz + _LATE_S
    late = sum(1e-9 * (s.stamp.host_ns - s.stamp.t_ns) > due_s for s in good)
    share = late / len(good)
    level: Level = "failure" if share > LOSS_FAILURE else "warning" if share > LOSS_WARNING else "ok"
    yield Finding(
        "imu",
        "late samples",
        level,
        f"{late} of {len(good)}",
        f"nearly none later than {due_s * 1e3:.0f} ms",
        "use a port of its own, not a hub; set the adapter's latency timer to 1 ms",
    )


def _filter(data: f.FilterData) -> Finding:
    """Finding on the state that the sensor's own filter reports."""
    state = f.FILTER_STATES.get(data.state, f"state {data.state}")
    condition = f.CONDITIONS.get(data.flags & f.CONDITION_MASK, "condition unknown")
    doubts = [text for bit, text in f.WARNINGS.items() if data.flags & bit]
    broken = bool(data.flags & f.SOLUTION_ERROR) or data.state < f.FIRST_RUNNING_STATE
    level: Level = "failure" if broken else "warning" if doubts or condition == "unstable" else "ok"
    message = f"{state}, {condition}" + (f", it warns of {' and '.join(doubts)}" if doubts else "")
    return Finding(
        "imu",
        "filter",
        level,
        message,
        "vertical gyro or AHRS, stable",
        "let the robot rest for some seconds; else switch the sensor off and on",
    )


class MicroStrain(SerialModel):
    """The MicroStrain 3DM-CV7 or 3DM-GV7 IMU."""

    kind, name, title = "imu", "microstrain", "MicroStrain 3DM-CV7 or 3DM-GV7 on a serial port"
    config, framing = MicrostrainConfig, "mip"
    driver = "hil.drivers.imu.microstrain.driver:MicrostrainImu"
    chip = "hil.fakes.imu.microstrain.chip:MicrostrainChip"
    probe_order, probe_bauds = 2, (115_200, 921_600)  # as delivered, and as fast as it can be set
    probe_writes = "a request for the identity of a MicroStrain sensor, at 115200 and 921600 baud"

    def check(self, watched: Watched) -> Iterable[Finding]:
        """Filter state and settings."""
        return look(watched)
