"""Watches a stopped robot for a slide, by camera and motion capture together."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hil.bench.loop_settings import motion_check
from hil.bench.pipelines import BenchModel
from hil.core.clock import nanoseconds
from hil.core.signals import SERVOS, CycleRecord, Inputs, ServoHold, ServoSample, Stamp, Status
from hil.loop.alignment import Alignment

_RESTS_NS = nanoseconds(0.2)
"""Time after a stop by which the wheels rest: what both sensors see then is a slide."""
_TURNS_RAD_S = 0.2
_POSES = ("tracker", "mocap")


class SlideWatch:
    """The slide of a robot while its hold is checked, in the frame of its body.

    Args:
        model: the bench model.
        seeing: sensors that measure this robot.
    """

    def __init__(self, model: BenchModel, seeing: Collection[str]) -> None:
        self._alignment = Alignment(model.alignment_parameters)
        self._motion = motion_check(model.config, model.geometry)
        self._slide = self._motion.slide()
        self._from_ns = 0
        self._able = {*_POSES} <= {*seeing}

    def drove(self, record: CycleRecord) -> None:
        """Note that wheels were commanded to turn: until they rest nothing is compared."""
        if max(map(abs, record.setpoint.wheel_rate_rad_s.tolist())) > _TURNS_RAD_S:
            self._from_ns = record.start_ns + _RESTS_NS

    def begin(self) -> None:
        """Begin a check and discard earlier samples."""
        self._alignment.reset()
        self._motion.reset()
        self._slide.reset()

    def saw(self, hold: ServoHold, samples: Mapping[str, Sequence[Any]]) -> None:
        """Process the servos' status and the sensors' samples, by sensor, of one look."""
        if not self._able:
            return
        tracker, mocap = (tuple(samples.get(name, ())) for name in _POSES)
        inputs = Inputs(0, hold.t_ns, servos=(_servo_sample(hold),), tracker=tracker, mocap=mocap)
        self._motion.update(self._alignment.measure(inputs))
        if hold.t_ns >= self._from_ns and not hold.late:
            self._slide.look()

    @property
    def along_m(self) -> float:
        """Slide along body x within the newest window that both sensors have shown, m; 0 for none."""
        return self._slide.excess_m if self._slide.certain else 0.0


def _servo_sample(hold: ServoHold) -> ServoSample:
    """The angles of a status as a sample; servos that did not answer count as timed out."""
    known = np.isfinite(hold.position_rad).tolist()
    status = tuple([Status.OK if one else Status.TIMEOUT for one in known])
    unknown = np.full(len(SERVOS), np.nan)
    return ServoSample(Stamp(hold.t_ns, hold.t_ns, 0), hold.position_rad, unknown, unknown, status)
