"""The kind `adhesion`: ducted fans that press the robot on its surface."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hil.config.adhesion import AdhesionConfig
from hil.config.robot import RobotConfig
from hil.core.device import DeviceKind, Figures, Force, Plot, Topic
from hil.core.finding import Finding, Level
from hil.core.signals import AdhesionSample, Inputs, Status
from hil.drivers.adhesion.dronecan.model import DroneCan
from hil.drivers.adhesion.vesc.model import Vesc
from hil.drivers.doctor_watch import Watched, losses
from hil.robot.motor_cross_checks import Reading, cross_check, is_steady

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND", "fan_state"]

_RATINGS = "correct adhesion.pole_pairs, rated_rpm, rpm_per_v; `hil run adhesion_check`"


def look(watched: Watched) -> Iterator[Finding]:
    """Findings about a fan that was watched."""
    samples, config = watched.samples, watched.config
    assert isinstance(config, AdhesionConfig)
    remedy = "switch on status message 1 at 50 Hz; check the CAN wiring"
    yield losses("adhesion", (s.status for s in samples), max(watched.due, 1), remedy)
    if not samples:
        return
    newest = samples[-1]
    yield _held(
        "battery",
        newest.input_v,
        "V",
        newest.input_v > config.low_input_v,
        f"over {config.low_input_v:g} V",
        "charge the fan's battery; switch on status message 5",
    )
    yield _held(
        "power stage",
        newest.fet_c,
        "degC",
        newest.fet_c < config.hot_fet_c,
        f"below {config.hot_fet_c:g} degC",
        "let it cool down; switch on status message 4",
    )
    yield _speed(samples, config)


def _speed(samples: Sequence[AdhesionSample], config: AdhesionConfig) -> Finding:
    """What the fan's speed gives, and what its other measurements say about it."""
    ratings = config.ratings()
    if beyond := next((s.trouble for s in reversed(samples) if s.status is Status.IMPLAUSIBLE), ""):
        return Finding("adhesion", "speed", "failure", beyond, "a speed that is possible", _RATINGS)
    usable = [s for s in samples if s.status is Status.OK]
    if not usable:
        return Finding("adhesion", "speed", "failure", "no usable report", "its speed", _RATINGS)
    middle = [_middle([float(getattr(s, name)) for s in usable]) for name in Reading._fields]
    speeds = [s.speed_rpm for s in usable]
    check = cross_check(ratings, Reading(*middle), steady=is_steady(ratings, speeds, middle[0]))
    force_n = ratings.force_at_n(middle[0])
    found = check.text or f"{middle[0]:.0f} 1/min, good for {force_n:.1f} N"
    if check.state == "confirmed":
        found += f"; {check.by} agree{'s' * (check.by == 'power')}, {100.0 * check.difference:+.0f} %"
    level: Level = "failure" if check.state == "contradicted" else "ok"
    return Finding("adhesion", "speed", level, found, "what duty, voltage and power say", _RATINGS)


def _middle(values: Sequence[float]) -> float:
    """Median of the values that are known; NaN for none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _held(check: str, value: float, unit: str, right: bool, expected: str, remedy: str) -> Finding:
    known = math.isfinite(value)
    level: Level = "ok" if right else "failure" if known else "warning"
    return Finding(
        "adhesion", check, level, f"{value:.1f} {unit}" if known else "not reported", expected, remedy
    )


_RAD_S_PER_RPM = 2.0 * math.pi / 60.0


def fan_state(sample: AdhesionSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState` of the fan; effort holds the motor's current in A."""
    velocity = (sample.speed_rpm * _RAD_S_PER_RPM,)
    return ros.joints(sample.stamp.t_ns, ("fan",), velocity=velocity, effort=(sample.motor_a,))


class Adhesion(DeviceKind):
    """A ducted fan that presses the robot on its surface."""

    name, noun, sample = "adhesion", "fan", AdhesionSample
    models, aliases = (Vesc(), DroneCan()), ("fan",)
    moves_robot = holds_robot = True
    max_age_s, max_gap_s, min_delivered = 0.01, 0.2, 0.9
    topics = (Topic("/adhesion/fan", "sensor_msgs/msg/JointState", fan_state),)
    plots = (
        Plot("Adhesion", "Force on the wall (N)", "adhesion/force_n"),
        Plot("Adhesion", "Most used wheel, share of its friction", "adhesion/utilisation"),
        Plot("Adhesion", "Fan (1/min)", "adhesion/speed_rpm"),
        Plot("Adhesion", "Fan's currents (A)", "adhesion/current_a"),
        Plot("Adhesion", "Fan's battery (V)", "adhesion/battery_v"),
        Plot("Adhesion", "Fan's temperatures (C)", "adhesion/temperature_c"),
    )
    silent_faults: ClassVar[Mapping[str, str]] = {
        "slow": "reports come less often, but often enough for `safety.adhesion_stale_s`",
        "delayed": "earlier reports have the same values while the fan turns steadily",
    }

    def stale_after_s(self, safety: Any, config: Any) -> float:
        """`safety.adhesion_stale_s`."""
        return float(safety.adhesion_stale_s)

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """NaN: the report rate is set in the controller, not in the bench file."""
        return math.nan

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """Speed, currents, battery, temperatures."""
        if inputs.adhesion:
            sample = inputs.adhesion[-1]
            yield "adhesion/speed_rpm", {"fan": sample.speed_rpm}
            yield "adhesion/current_a", {"motor": sample.motor_a, "battery": sample.input_a}
            yield "adhesion/battery_v", {"battery": sample.input_v}
            yield "adhesion/temperature_c", {"power stage": sample.fet_c, "motor": sample.motor_c}

    def forces(self, inputs: Inputs, robot: RobotConfig, config: AdhesionConfig | None) -> Iterator[Force]:
        """Force of the fan at its latest speed; none where that is unknown."""
        for sample in inputs.adhesion[-1:]:
            if config is not None and sample.status is Status.OK and math.isfinite(sample.speed_rpm):
                yield Force("fan", np.zeros(3), np.array([0.0, 0.0, -config.force_at_n(sample.speed_rpm)]))

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Reports, faults, battery, temperatures."""
        return look(watched)


KIND = Adhesion()
