"""The kind `thrust`: propellers that carry part of the robot's weight."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hil.config.robot import RobotConfig
from hil.config.thrust import ThrustConfig
from hil.core.device import DeviceKind, Figures, Force, Plot, Topic
from hil.core.finding import Finding
from hil.core.signals import Inputs, Status, ThrustSample
from hil.drivers.doctor_watch import Watched
from hil.drivers.thrust.teensy.model import Teensy
from hil.drivers.thrust.vesc.model import VescPropellers

if TYPE_CHECKING:
    from hil.recording.rosbags_adapter import MessageMaker

__all__ = ["KIND", "propeller_state"]


def propeller_state(sample: ThrustSample, ros: MessageMaker) -> Any:
    """`sensor_msgs/JointState`; the position holds the throttle 0..1."""
    return ros.joints(sample.stamp.t_ns, ("propellers",), position=(sample.throttle,))


class Thrust(DeviceKind):
    """Propellers that push the robot up the wall."""

    name, noun, sample = "thrust", "propellers", ThrustSample
    models, aliases = (Teensy(), VescPropellers()), ("propellers",)
    moves_robot = holds_robot = True
    max_age_s, max_gap_s = 0.005, 0.5
    topics = (Topic("/adhesion/propellers", "sensor_msgs/msg/JointState", propeller_state),)
    plots = (Plot("Adhesion", "Propellers' throttle", "adhesion/throttle"),)
    silent_faults: ClassVar[Mapping[str, str]] = {"*": "this controller sends nothing back"}

    def rate_hz(self, config: Any, loop_hz: float) -> float:
        """Rate at which the throttle is repeated; NaN where the controllers set the rate of their reports."""
        return 1.0 / float(getattr(config, "repeat_s", math.nan))

    def figures(self, inputs: Inputs) -> Iterator[tuple[str, Figures]]:
        """The throttle, 0..1, as the figure of this kind."""
        if inputs.thrust:
            yield "adhesion/throttle", {"propellers": inputs.thrust[-1].throttle}

    def forces(self, inputs: Inputs, robot: RobotConfig, config: ThrustConfig | None) -> Iterator[Force]:
        """Push of the propellers at the throttle that was sent last; none where the throttle is unknown."""
        for sample in inputs.thrust[-1:]:
            if config is not None and sample.status is Status.OK and math.isfinite(sample.throttle):
                yield from itertools.starmap(Force, robot.propellers(config.force_at_n(sample.throttle)))

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Findings on the samples."""
        yield from watched.losses("check cable and supply of the propellers' controllers")


KIND = Thrust()
