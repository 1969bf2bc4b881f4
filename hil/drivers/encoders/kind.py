"""External encoders on the four steering axes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.config.encoders import EncodersConfig
from hil.core.device import DeviceKind, Figures, Plot, Topic
from hil.core.finding import Finding, Level
from hil.core.signals import STEERS, WHEELS, EncoderSample, Inputs
from hil.drivers.doctor_watch import Watched, losses
from hil.drivers.encoders.as5045.model import As5045

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND", "encoder_state"]


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about encoders that were watched."""
    config: EncodersConfig = watched.config
    encoders = watched.device
    link = Path("/sys/class/net") / config.channel / "operstate"
    down = config.interface == "socketcan" and link.exists() and link.read_text().strip() == "down"
    broken = encoders.bus_error or f"{config.channel} is down" * down
    level: Level = "failure" if broken else "warning" if encoders.error_frames else "ok"
    yield Finding(
        "encoders",
        "CAN state",
        level,
        broken or f"{encoders.error_frames} error frames",
        "no error frames",
        f"check bit rate ({config.bitrate}), termination (60 ohm) and wiring; "
        f"sudo ip link set {config.channel} up type can bitrate {config.bitrate} restart-ms 100",
    )
    yield _node(watched)
    yield from _frames(watched)
    for i, wheel in enumerate(WHEELS):
        statuses = (sample.status[i] for sample in watched.samples)
        found = losses("encoders", statuses, watched.due, "check magnet distance and CAN wiring")
        yield replace(found, check=f"{wheel} samples")


def _frames(watched: Watched) -> Iterator[Finding]:
    """Findings on frames with the node's identifiers: their clock, a second node, a wrong length."""
    encoders, bus = watched.device, watched.config.bus
    if encoders.wrong_unit:
        yield Finding(
            "encoders",
            "node time",
            "failure",
            encoders.wrong_unit,
            "a clock that runs as fast as this computer's",
            f"correct the factor of NodeTime in {watched.config.dbc_path} (encoders.dbc)",
        )
    if encoders.two_nodes:
        yield Finding(
            "encoders",
            "identifiers",
            "failure",
            encoders.two_nodes,
            f"one node of each identifier on {bus}",
            "set another address at the switch of one of them, and encoders.node_id to that of ours",
        )
    if encoders.malformed:
        yield Finding(
            "encoders",
            "frame length",
            "warning",
            f"{encoders.malformed} frames of a wrong length",
            f"frames as in {watched.config.dbc_path.name}",
            "find the other node that sends with these identifiers, or name the node's DBC in encoders.dbc",
        )


def _node(watched: Watched) -> Finding:
    """Finding on the status message of the node; a node without one is accepted."""
    status, config = watched.device.node_status, watched.config
    expected = f"frames as in {config.dbc_path.name}, {config.rate_hz:g} Hz"
    remedy = "flash the firmware of this version (firmware/as5045_node), or name its DBC in encoders.dbc"
    if status.other_layout:
        return Finding("encoders", "node", "failure", status.other_layout, expected, remedy)
    if status.heard and abs(status.rate_hz - config.rate_hz) > 0.5:  # it reports whole numbers
        found = f"{status}, {status.rate_hz:g} Hz"
        return Finding(
            "encoders", "node", "warning", found, expected, f"set encoders.rate_hz to {status.rate_hz:g}"
        )
    if status.counted:
        remedy = "check the chips' wiring for wrong parity, the CAN wiring and its termination for the rest"
        return Finding("encoders", "node", "warning", f"{status}: {status.counted}", "no errors", remedy)
    return Finding("encoders", "node", "ok", str(status))


def encoder_state(sample: EncoderSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the external encoders' own angles, without those that cannot be used."""
    return ros.joints(sample.stamp.t_ns, STEERS, position=sample.angle_rad)


class Encoders(DeviceKind):
    """Angles of the steering axes, measured by encoders outside the servos."""

    name, noun, sample = "encoders", "steering encoders", EncoderSample
    models, aliases, endpoint, labels = (As5045(),), ("can",), "can", WHEELS
    max_age_s, max_gap_s, min_delivered = 0.01, 0.05, 0.98
    has_own_clock = True
    topics = (Topic("/steering_encoders", "sensor_msgs/msg/JointState", encoder_state),)
    plots = (Plot("Sensors", "Steering angles by encoders (rad)", "encoders/angle_rad"),)

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Angle of each axis, before the zero of the bench file."""
        if inputs.encoders:
            yield "encoders/angle_rad", dict(zip(WHEELS, inputs.encoders[-1].angle_rad.tolist(), strict=True))

    def check(self, watched: Watched) -> Iterator[Finding]:
        """CAN link, node, and each axis."""
        return look(watched)


KIND = Encoders()
