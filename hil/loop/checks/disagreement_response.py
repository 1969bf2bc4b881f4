"""The response to sensors that disagree about motion: a warning, an excluded device, or a stop."""

from collections.abc import Mapping

from hil.core.signals import Event
from hil.core.stop_suspects import together
from hil.loop.checks.cusum import Disagreement
from hil.loop.checks.exclusion import Exclusion
from hil.loop.checks.fall import look_at
from hil.loop.checks.motion_agreement import MotionCheck
from hil.loop.checks.servos import ServoCheck
from hil.loop.cycle_data import Check, Cycle
from hil.loop.safety_limits import Checks


class AgreementCheck(Check):
    """Compares camera, wheels, gyro and motion capture; decides which to trust, and whether to stop.

    Args:
        motion: check that compares them.
        checks: checks of the bench.
        servos: check that detects a wheel that does not turn.
        excluded: record of the excluded devices.
        holders: devices that keep the robot on its surface: noun by kind.

    Attributes:
        doubted: devices whose motion data were in doubt since `reset`, and whether others agreed against
            them.
    """

    def __init__(
        self,
        motion: MotionCheck,
        checks: Checks,
        servos: ServoCheck,
        excluded: Exclusion,
        holders: Mapping[str, str],
    ) -> None:
        self._motion, self._checks, self._servos = motion, checks, servos
        self._excluded, self._holders = excluded, holders
        self.doubted: dict[str, bool] = {}

    def reset(self) -> None:
        """Clear the state of the run."""
        self._motion.reset()
        self.doubted.clear()

    def on_samples(self, cycle: Cycle) -> None:
        """Check the motion of a cycle; stops with `sensors_disagree`, also with `blocked`."""
        checks = self._checks
        for doubt in self._motion.update(cycle.measurements):
            self._note(doubt)
            if checks.wheels is not None and doubt.may_slide:
                checks.wheels.doubt()
            if not doubt.grave:
                if doubt.unseen and checks.needs_camera:
                    cycle.inflate(*doubt.inflation)
                cycle.events.append(self._event(doubt, cycle.inputs.t_ns))
            elif checks.stops_by_steering and self._excluded.can_do_without(doubt):
                self._motion.leave_out(doubt.source)
                self._excluded.take(doubt, cycle)
            elif checks.needs_camera:
                standing = self._servos.standing()
                if standing and "blocked" not in cycle.stops:
                    cycle.stop("blocked", standing)
                event = self._event(doubt, cycle.inputs.t_ns)
                cycle.stop("sensors_disagree", event.message, event.suspects)

    def _event(self, doubt: Disagreement, t_ns: int) -> Event:
        """Event for the source device, or both if either may be wrong, and devices that hold the robot."""
        names, message = [doubt.source, *([] if doubt.confirmed else [doubt.against])], doubt.message
        if doubt.may_slide:
            names += self._holders
            message += look_at(self._holders, "if it slides, look")
        return Event(t_ns, "warning", together(names), message, key=doubt.key, factor=doubt.factor)

    def _note(self, doubt: Disagreement) -> None:
        """Record that both devices are in doubt, or only the source if others agree against it."""
        if doubt.confirmed:
            sure = {name for name, known in self.doubted.items() if known}
            self.doubted.clear()
            self.doubted.update(dict.fromkeys((*sure, doubt.source), True))
        else:
            for name in (doubt.source, doubt.against):
                self.doubted.setdefault(name, False)
