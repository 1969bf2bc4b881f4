"""The eight servos: four drives and four steers on one bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hil.core.device import DeviceKind, Figures, Plot, Topic
from hil.core.finding import Finding
from hil.core.geometry import Array
from hil.core.signals import SERVOS, Inputs, ServoSample
from hil.devices.doctor_watch import Watched
from hil.devices.servos.doctor_check import look
from hil.devices.servos.dynamixel_model import Dynamixel

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "joint_state"]


def joint_state(sample: ServoSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the servos' own angles; effort holds the current in A."""
    columns = sample.position_rad, sample.velocity_rad_s, sample.current_a
    return ros.joints(sample.stamp.t_ns, SERVOS, *columns)


class Servos(DeviceKind):
    """Four drives and four steers."""

    name, noun, sample = "servos", "servo positions", ServoSample
    models, aliases, labels = (Dynamixel(),), ("servo",), SERVOS
    moves_robot = True
    max_age_s, max_gap_s, min_delivered = 0.005, 0.05, 0.98
    topics = (Topic("/joint_states", "sensor_msgs/msg/JointState", joint_state),)
    plots = (
        Plot("Servos", "Servo angles (rad)", "servos/position_rad"),
        Plot("Servos", "Servo rates (rad/s)", "servos/velocity_rad_s"),
        Plot("Servos", "Motor currents (A)", "servos/current_a"),
        Plot("Health", "Temperatures (C)", "servos/temperature_c"),
        Plot("Health", "Voltages (V)", "servos/voltage_v"),
    )
    motion_threshold = 0.01  # rad: a servo holds its place within three counts, 0.005
    silent_faults: ClassVar[Mapping[str, str]] = {"slow": "answers come later, and within their time"}

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.servo_stale_s`."""
        return float(safety.servo_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """They are asked in each cycle."""
        return loop_hz

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Angles, rates, currents, temperatures and voltages."""
        if inputs.servos:
            sample = inputs.servos[-1]
            yield "servos/position_rad", _by_servo(sample.position_rad)
            yield "servos/velocity_rad_s", _by_servo(sample.velocity_rad_s)
            yield "servos/current_a", _by_servo(sample.current_a)
        if inputs.health:
            yield "servos/temperature_c", _by_servo(inputs.health[-1].temperature_c)
            yield "servos/voltage_v", _by_servo(inputs.health[-1].voltage_v)

    def motion_value(self, sample: ServoSample) -> Array | None:
        """Angles (8,) in rad."""
        return sample.position_rad if sample.ok else None

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Samples, hardware errors, supply, temperature."""
        return look(watched)


def _by_servo(values: Array) -> Figures:
    return dict(zip(SERVOS, values.tolist(), strict=True))


KIND = Servos()
