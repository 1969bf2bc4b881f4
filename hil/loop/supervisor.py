"""Safety: checks data before they are used and setpoints before they are sent.

Stale, implausible or faulty data are reported as events; a condition under which the robot must stop raises
`SafetyStop`, and the loop calls `stop()` (wheels at rest, torque on). All checks of a stage run first, and
their findings are reported together. Deterministic: depends only on the inputs since `reset`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hil.core.errors import SafetyStop
from hil.core.signals import Event, Inputs, Measurements, WheelSetpoint
from hil.core.stop_suspects import together
from hil.loop.checks.cusum import WHEELS
from hil.loop.checks.damaged_reports import DamagedReports
from hil.loop.checks.disagreement_response import AgreementCheck
from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.fall import FallCheck, look_at
from hil.loop.checks.filter_fit import FilterFit
from hil.loop.checks.frame_move import FrameMove
from hil.loop.checks.loop_pause import LoopPause
from hil.loop.checks.lost_reads import LostReads
from hil.loop.checks.lost_sensor import LostCheck
from hil.loop.checks.out_of_plane import OutOfPlane
from hil.loop.checks.path_error import PathCheck
from hil.loop.checks.sensor_rate import SensorRate
from hil.loop.checks.sensor_status import SensorStatus
from hil.loop.checks.servos import ServoCheck
from hil.loop.checks.slide import SlideCheck
from hil.loop.checks.state_valid import ObserverCheck, UsableCheck
from hil.loop.cycle_data import NO_INFLATION, Check, Cycle, LastCycle
from hil.loop.safety_limits import Checks, SafetyLimits


class Supervisor:
    """Runs the checks of one bench in their order, and keeps setpoints within limits.

    Args:
        limits: limits of the bench.
        checks: checks of sensors against each other.

    Attributes:
        in_order: the checks, the most serious first: the first reason to stop names the stop.
        left_out: devices that are excluded.
        observers: check of the estimates that are not followed.
        fall: check for a fall by IMU and camera.
        slide: check for slides by two sensors; None for a robot that cannot fall.
        last: data from the previous cycle.
    """

    def __init__(self, limits: SafetyLimits, *, checks: Checks | None = None) -> None:
        self.limits, self.checks = limits, checks if checks is not None else Checks()
        own, stale_s = self.checks, dict(limits.stale_s)
        self._holders = own.holders if limits.on_wall else {}
        self._widest_rad = limits.steering_limit_rad + 1e-9
        self.left_out = Exclusion(own.estimated, on_wall=limits.on_wall)
        self._pace, self.observers = LoopPause(own.emulated, own.served), ObserverCheck()
        samples = SensorStatus(stale_s, own.gap_s, own.brought, self._pace.lost_ns)
        self._servos = servos = ServoCheck(stale_s.pop("servos", None), self._pace, limits.servo_ids)
        self._agreement = (
            None
            if own.motion is None
            else AgreementCheck(own.motion, own, servos, self.left_out, self._holders)
        )
        self.slide = (
            SlideCheck(
                own.motion.slide(),
                own.motion.radius_m,
                own.hold,
                tuple(self._holders),
                look_at(self._holders, "look"),
            )
            if own.motion is not None and own.hold is not None and own.hold.can_fall
            else None
        )
        if own.estimate is not None:
            own.estimate.excluded, own.estimate.holders = self.left_out, tuple(self._holders)
            own.estimate.advice = look_at(self._holders, "if it slides, look")
        self.fall = FallCheck(
            limits.adhesion_limit_m_s2, limits.body_speed_limit_m_s, self._holders, own.rests_on
        )
        found: list[Check | None] = [
            self.fall,
            own.hold,
            own.weight,
            self._pace,
            servos,
            LostReads(servos.names),
            samples,
            SensorRate(own.healthy),
            LostCheck(samples, own, self.left_out),
            own.wheels,
            own.steering,
            self._agreement,
            own.radii,
            self.slide,
            FrameMove(self.left_out),
            OutOfPlane(),
            own.camera,
            DamagedReports(),
            UsableCheck(),
            FilterFit(),
            PathCheck(limits),
            own.estimate,
            self.observers,
        ]
        self.in_order: list[tuple[str, Check]] = [("", check) for check in found if check is not None]
        self.in_order += [(kind, check) for kind, added in own.added.items() for check in added]
        self._of_samples = self._overriding("on_samples")
        self._of_estimate = self._overriding("on_estimate")
        self.reset()

    def _overriding(self, stage: str) -> list[tuple[str, Check]]:
        """The checks that look at something in a stage, in their order."""
        nothing = getattr(Check, stage)
        return [(kind, one) for kind, one in self.in_order if getattr(type(one), stage) is not nothing]

    def reset(self) -> None:
        """Clear the state of the run."""
        self.last = LastCycle()
        self.left_out.reset()
        for _, check in self.in_order:
            check.reset()

    def begin(self, inputs: Inputs, measurements: Measurements) -> Cycle:
        """Make a cycle from inputs and aligned measurements, with the data from the previous cycle."""
        inflation, self.last.inflation = self.last.inflation, NO_INFLATION
        return Cycle(inputs, measurements, self.last, inflation=inflation)

    def check_samples(self, cycle: Cycle) -> None:
        """Check the devices' samples.

        Raises:
            SafetyStop: `adhesion`, those of `hil.loop.checks.adhesion`, `weight`, `sliding`,
                `hardware_error`, `stale_servos`, `held_up`, `blocked`, `servo_jump`, `horn_slip`,
                `sensors_disagree`, `stale_tracker`, `lost_*`, or the reason of a check of a device kind; the
                message names all findings. A silent IMU is only an event, and so is a silent camera that the
                estimate in the loop does not use; for a lasting silence their driver raises
                `DeviceTimeoutError`.
        """
        for cycle.source, check in self._of_samples:
            check.on_samples(cycle)
        cycle.stops = self._pace.excused(cycle.stops)
        cycle.must_go_on(self._pace.beside(cycle.inputs.t_ns))

    def check_estimate(self, cycle: Cycle) -> None:
        """Check the estimate of a cycle, after it has been computed.

        Raises:
            SafetyStop: `not_finite`, `negative_variance`, `stale_estimate`, `heading`, `tracking`,
                `sensors_disagree` with motion capture, or the reason of a check of a device kind.
        """
        assert cycle.state is not None
        before = len(cycle.events)
        for cycle.source, check in self._of_estimate:
            check.on_estimate(cycle)
        heading_rad = cycle.state.pose_body_in_wall.item(2)
        self.last = LastCycle(heading_rad, self.last.wheel_rate_rad_s, cycle.next_inflation)
        cycle.must_go_on(self._pace.beside(cycle.state.t_ns))
        cycle.events[before:] = map(self._may_slide, cycle.events[before:])

    def _may_slide(self, event: Event) -> Event:
        """Add a hint to a warning on wheels that differ from other sensors: the robot may be sliding."""
        if event.source != WHEELS.name or not self._holders:
            return event
        message = event.message + look_at(self._holders, "if it slides, look")
        return replace(event, source=together((event.source, *self._holders)), message=message)

    def excuse(self, device: str) -> str:
        """Text: by how much this computer was late, where a silent device is emulated; else empty."""
        return self._pace.excuse(device)

    @property
    def doubted(self) -> Mapping[str, bool]:
        """Devices whose motion data were in doubt, and whether others agreed against them."""
        return {} if self._agreement is None else self._agreement.doubted

    @property
    def agreed(self) -> frozenset[str]:
        """Devices that have agreed with another on the motion since `reset`."""
        return frozenset() if self.checks.motion is None else self.checks.motion.agreed

    def limit(self, setpoint: WheelSetpoint) -> WheelSetpoint:
        """Limit a setpoint; all wheel rates are scaled equally, which keeps the centre of rotation.

        The wheels wait (rate 0) while servos have not answered for a while, before that becomes a stop.

        Raises:
            SafetyStop: `not_finite` or `steering_limit`.
        """
        rates: list[float] = setpoint.wheel_rate_rad_s.tolist()
        angles: list[float] = setpoint.steering_rad.tolist()
        if not math.isfinite(sum(rates) + sum(angles)):
            raise SafetyStop("not_finite", "a setpoint is not finite")
        if max(angles) > self._widest_rad or min(angles) < -self._widest_rad:
            shown_deg = np.degrees(angles).round(1).tolist()
            limit_deg = math.degrees(self.limits.steering_limit_rad)
            raise SafetyStop(
                "steering_limit",
                f"steering setpoint {shown_deg} deg, beyond {limit_deg:.4g} deg (safety.steering_limit_rad); "
                "look at alignment.steer_zero_rad (rad; see hil run steering_zero) and at the controller",
            )
        fastest = self.limits.wheel_rate_limit_rad_s
        if max(rates) > fastest or min(rates) < -fastest:
            slowed = setpoint.wheel_rate_rad_s * (fastest / max(map(abs, rates)))
            setpoint, rates = WheelSetpoint(slowed, setpoint.steering_rad), slowed.tolist()
        if self._servos.waits:
            setpoint, rates = WheelSetpoint(np.zeros(4), setpoint.steering_rad), [0.0] * 4
        self.last.wheel_rate_rad_s = rates
        return setpoint
