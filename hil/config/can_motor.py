"""Configuration of a motor controller on CAN that stops its motor when commands stop."""

from typing import Annotated, Any

from hil.config.can_bus import CanConfig
from hil.config.field_types import Patience, Within

HIGHEST_DUTY = 0.95


class DaemonMotorConfig(CanConfig):
    """A motor whose commands come from a daemon, a process of its own.

    Attributes:
        timeout_s: time without a command after which the controller releases the motor, as set in VESC Tool;
            the doctor reads the actual value, if the controller reports it.
        ramp_up_s, ramp_down_s: time from rest to the highest duty, and back.
        fail_after_s: uninterrupted silence that raises.
    """

    timeout_s: Annotated[
        float, Within(0.5, 60.0, "ten commands may be late; at 0 the motor would run for ever; 1 is usual")
    ] = 1.0
    ramp_up_s: Annotated[float, Within(0.2, 60.0, "s from rest to full duty")] = 2.0
    ramp_down_s: Annotated[float, Within(1.0, 60.0, "s; a fan that stops at once drops the robot")] = 4.0
    fail_after_s: Patience = 1.0

    def daemon_spec(self) -> dict[str, Any]:
        """The arguments of its daemon's `hil.fan_daemon.spec.Spec`."""
        return {
            "interface": self.interface,
            "channel": self.channel,
            "bitrate": self.bitrate,
            "options": dict(self.options),
            "timeout_s": self.timeout_s,
            "ramp_up_s": self.ramp_up_s,
            "ramp_down_s": self.ramp_down_s,
        }
