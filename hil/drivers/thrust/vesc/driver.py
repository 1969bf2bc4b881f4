"""Driver of propellers behind VESCs on CAN: forces to speeds that the daemon commands, reports to samples."""

import contextlib
import math

import can

from hil.config.adhesion import VescConfig
from hil.config.thrust_vesc import VescThrustConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.cross_check import CrossCheck
from hil.core.errors import DeviceError
from hil.core.finding import Finding
from hil.core.signals import Stamp, Status, ThrustSample
from hil.drivers.motor_controllers.daemon_motor import DaemonMotor
from hil.drivers.motor_controllers.vesc_identity import BusReplies, discover_controllers
from hil.drivers.motor_controllers.vesc_settings import Answers
from hil.fan_daemon.commander import MakeCommander, finding
from hil.fan_daemon.fan_control import RELEASE, SetPoint
from hil.fan_daemon.spec import Spec
from hil.links.vesc import Packet, Status5, address, decode
from hil.links.vesc import Status as Report
from hil.robot.motor_cross_checks import Reading, Steadiness, cross_check, impossible
from hil.streams.silence_limit import SilenceTimer
from hil.streams.steady_volts import SteadyVolts
from hil.streams.stuck_values import StuckTest

_STUCK_S = 0.5
_RUNNING = 0.05
"""Share of the full speed."""
_DOUBTS = 3
"""Number of contradicted reports in a row after which a new set-point is taken back."""
_UNHEARD_NS, _SETTLES_NS, _WATCHED_NS = nanoseconds(0.6), nanoseconds(1.5), nanoseconds(4.0)
"""Time that a set-point waits for the voltage of running propellers, and for a steady speed: before that the
comparison is coarse; time that it is watched for."""


class VescThrust(DaemonMotor[VescThrustConfig, ThrustSample]):
    """All propellers, at one speed.

    Args:
        config: bus, controllers, full force.
        clock: the bench clock.
        make_commander: function that makes the motor commander from (spec, clock); the daemon's client when
            None.
    """

    name = "thrust"
    noun = "the propellers"

    def __init__(
        self, config: VescThrustConfig, clock: Clock, make_commander: MakeCommander | None = None
    ) -> None:
        packets = (Packet.STATUS, Packet.STATUS_5)
        self._reports = {address(packet, one) for packet in packets for one in config.controller_ids}
        self._ratings = config.ratings()
        self._known: dict[int, tuple[VescConfig, BusReplies, Answers]] = {}
        super().__init__(config, clock, make_commander)

    def _forget(self) -> None:
        super()._forget()
        self._silence_timers = {
            one: SilenceTimer(self._config.fail_after_s) for one in self._config.controller_ids
        }
        for timer in self._silence_timers.values():
            timer.begin(self._clock.now_ns())
        self._heard: set[int] = set()
        self._stuck = {one: StuckTest(_STUCK_S) for one in self._config.controller_ids}
        self._newest: dict[int, tuple[int, Report]] = {}
        self._volts = {one: SteadyVolts() for one in self._config.controller_ids}
        self._volts_v = dict.fromkeys(self._config.controller_ids, math.nan)
        self._steady = {one: Steadiness(self._ratings) for one in self._config.controller_ids}
        self._settled = dict.fromkeys(self._config.controller_ids, False)
        self._doubts, self._trouble, self._share = 0, "", math.nan
        self._wish: SetPoint | None = None
        self._wished_ns = self._watched_ns = 0
        self._before = RELEASE

    def _greet(self, spec: Spec) -> dict[str, str]:
        self._known = {motor.controller_id: self._met(motor, spec) for motor in self._config.motors()}
        ids = ", ".join(map(str, self._config.controller_ids))
        reported = dict.fromkeys(answers.firmware or "not reported" for _, _, answers in self._known.values())
        return {
            "model": "VESC",
            "port": f"{self._link.port}, controllers {ids}",
            "firmware": ", ".join(reported),
        }

    def _met(self, motor: VescConfig, spec: Spec) -> tuple[VescConfig, BusReplies, Answers]:
        answers = Answers()
        seen = discover_controllers(self._link, motor, self._clock, answers)
        seen.key = "controller_ids"
        seen.check(self.name, self._link, motor, answers, spec)
        return motor, seen, answers

    def read(self) -> tuple[ThrustSample, ...]:
        """One sample whenever all controllers have reported their speed.

        Raises:
            DeviceTimeoutError: a controller has been silent for `fail_after_s`.
        """
        self._must_be_open()
        samples: list[ThrustSample] = self._link.read_samples()
        now_ns = self._clock.now_ns()
        lost = {
            one: timer.overdue_ns(one in self._heard, now_ns) for one, timer in self._silence_timers.items()
        }
        self._heard.clear()
        longest = max(lost, key=lost.__getitem__)
        if lost[longest]:
            raise self._silence(f"controller {longest}", lost[longest], "its propellers stop")
        if samples:
            self._link.error = ""
            self._carry_out(now_ns)
        return tuple(samples)

    def _is_own(self, key: int) -> bool:
        return key in self._reports

    def _meaning(self, t_ns: int, message: can.Message, now_ns: int) -> ThrustSample | None:
        if message.arbitration_id not in self._reports or not message.is_extended_id:
            return None
        said = decode(message.arbitration_id, message.data)
        if isinstance(said, Status5):
            one = said.controller_id
            self._volts_v[one] = self._volts[one].take(said.input_v)
        if not isinstance(said, Report):
            return None
        self._heard.add(said.controller_id)
        self._newest[said.controller_id] = (t_ns, said)
        whole = len(self._newest) == len(self._silence_timers) and t_ns > self._latest_ns
        return self._sample(t_ns, now_ns) if whole else None

    def _sample(self, t_ns: int, now_ns: int) -> ThrustSample:
        """Sample of the newest reports; `throttle` is the share of full speed of the same force."""
        full_rpm, status = self._config.full_rpm, Status.OK
        shares, found = [], []
        for one, (seen_ns, said) in self._newest.items():
            speed_rpm = said.erpm / self._config.pole_pairs
            shares.append(speed_rpm / full_rpm)
            now = Reading(speed_rpm, said.duty, self._volts_v[one], said.current_a)
            if impossible(self._ratings, now):
                status = Status.IMPLAUSIBLE
            elif self._stuck[one].stuck(said, seen_ns) and abs(shares[-1]) > _RUNNING:
                status = Status.FROZEN
            steady = self._settled[one] = self._steady[one].follow(seen_ns, now)
            found.append((one, cross_check(self._ratings, now, steady=steady)))
        self._newest, self._latest_ns = {}, t_ns
        self._take_checks(found)
        self._sequence += 1
        stamp = Stamp(t_ns, now_ns, self._sequence)
        if status is not Status.OK:
            return ThrustSample(stamp, math.nan, math.nan, status, self._trouble)
        self._share = math.sqrt(sum(max(share, 0.0) ** 2 for share in shares) / len(shares))
        return ThrustSample(stamp, self._share, full_rpm * sum(shares) / len(shares), status, self._trouble)

    def _take_checks(self, found: list[tuple[int, CrossCheck]]) -> None:
        """Note the controllers whose reports contradict each other."""
        wrong = [f"controller {one}: {check.text}" for one, check in found if check.text]
        self._doubts = self._doubts + 1 if wrong else 0
        wrong += ["the new set-point waits until they agree"] * (bool(wrong) and self._wish is not None)
        if not wrong or self._doubts >= _DOUBTS:
            self._trouble = "; ".join(wrong)

    def _carry_out(self, now_ns: int) -> None:
        """Send a set-point that has waited; take it back where the propellers do not answer as they should.

        What runs may carry the robot: it is changed only once voltage and speed have been compared.
        """
        commander = self._must_be_open()
        if self._wish is not None:
            if self._share <= _RUNNING or self._compared(now_ns):
                before = commander.status().get("target") or RELEASE
                with contextlib.suppress(DeviceError):  # the daemon has no report of them yet
                    commander.set(self._wish)
                    self._wish, self._before = None, SetPoint(*before)
                    self._watched_ns = now_ns + _WATCHED_NS
        elif now_ns < self._watched_ns and self._doubts >= _DOUBTS:
            self._watched_ns = 0
            if self._before.value > 0.0:
                commander.set(self._before)
            else:
                commander.end("they were at rest before, and their reports contradict each other")

    def _compared(self, now_ns: int) -> bool:
        """Whether voltage and speed agree at a steady speed, or cannot be compared."""
        waited_ns = now_ns - self._wished_ns
        if not all(math.isfinite(v) for v in self._volts_v.values()):
            return waited_ns > _UNHEARD_NS
        return not self._doubts and (all(self._settled.values()) or waited_ns > _SETTLES_NS)

    def set_force_n(self, force_n: float) -> None:
        """Command a force; for one out of range it raises `UsageError` and sends nothing."""
        commander = self._must_be_open()
        self._config.check_force(force_n, self.name)
        if force_n == 0.0 and commander.status().get("sent") is None:
            return
        self._wish = SetPoint("erpm", self._config.pole_pairs * self._config.speed_for_rpm(force_n))
        self._wished_ns = self._clock.now_ns()
        self._carry_out(self._wished_ns)

    def set_duty(self, duty: float) -> None:
        """Command a share of the voltage; raises `UsageError`."""
        commander = self._must_be_open()
        commander.set(self._duty(duty))

    def diagnose(self) -> tuple[Finding, ...]:
        """Settings of each controller, and whether a fan daemon keeps them running."""
        reported = [
            Finding(f.device, f"controller {one}: {f.check}", f.level, f.found, f.expected, f.remedy)
            for one, (motor, seen, answers) in self._known.items()
            for f in seen.findings(self.name, motor, answers)
        ]
        return (*reported, finding(self.name, self._commander))
