"""The eight servos: four drives and four steers on one bus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hil.devices.servos.dynamixel import DYNAMIXEL
from hil.devices.servos.look import look
from hil.vocabulary.geometry import Array
from hil.vocabulary.kinds import DeviceKind, Figures, Plot, Topic, Witness
from hil.vocabulary.signals import SERVOS, Inputs, ServoSample

if TYPE_CHECKING:
    from hil.recording.ros_types import MessageMaker

__all__ = ["KIND", "joint_state"]


def joint_state(sample: ServoSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the servos' own angles; effort holds the current in A."""
    columns = sample.position_rad, sample.velocity_rad_s, sample.current_a
    return ros.joints(sample.stamp.t_ns, SERVOS, *columns)


def _figures(inputs: Inputs) -> Iterator[tuple[str, Figures]]:
    if inputs.servos:
        sample = inputs.servos[-1]
        yield "servos/position_rad", _by_servo(sample.position_rad)
        yield "servos/velocity_rad_s", _by_servo(sample.velocity_rad_s)
        yield "servos/current_a", _by_servo(sample.current_a)
    if inputs.health:
        yield "servos/temperature_c", _by_servo(inputs.health[-1].temperature_c)
        yield "servos/voltage_v", _by_servo(inputs.health[-1].voltage_v)


def _by_servo(values: Array) -> Figures:
    return dict(zip(SERVOS, values.tolist(), strict=True))


def _positions(sample: ServoSample) -> Array | None:
    return sample.position_rad if sample.ok else None


KIND = DeviceKind(
    name="servos",
    noun="servo positions",
    sample=ServoSample,
    models=(DYNAMIXEL,),
    actuates=True,
    aliases=("servo",),
    labels=SERVOS,
    stale_s=lambda safety, own: safety.servo_stale_s,
    age_s=0.005,
    gap_s=0.05,
    delivered=0.98,
    topics=(Topic("/joint_states", "sensor_msgs/msg/JointState", joint_state),),
    figures=_figures,
    plots=(
        Plot("Servos", "Servo angles (rad)", "servos/position_rad"),
        Plot("Servos", "Servo rates (rad/s)", "servos/velocity_rad_s"),
        Plot("Servos", "Motor currents (A)", "servos/current_a"),
        Plot("Health", "Temperatures (C)", "servos/temperature_c"),
        Plot("Health", "Voltages (V)", "servos/voltage_v"),
    ),
    witness=Witness(still=0.01, value=_positions),  # rad: a servo holds its place within three counts, 0.005
    look=look,
    passes={"slow": "answers come later, and within their time"},
)
