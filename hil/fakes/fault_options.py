"""The options of faults: what each means, and which numbers it takes.

A device says which options a kind of fault takes; what they may be stands here, once, for all devices.
"""

from __future__ import annotations

from typing import NamedTuple


class Option(NamedTuple):
    """One option: what it means, its least and greatest value, and whether it is a whole number."""

    meaning: str
    least: float
    most: float
    whole: bool = False

    @property
    def range(self) -> str:
        """Which numbers it takes."""
        return f"{'whole, ' if self.whole else ''}{self.least:.7g} to {self.most:.7g}"

    @property
    def expected(self) -> str:
        """Which numbers it takes, for a message."""
        return f"a {'whole ' if self.whole else ''}number from {self.least:.7g} to {self.most:.7g}"

    def takes(self, value: float) -> bool:
        """Whether it may be this; NaN never."""
        return self.least <= value <= self.most and (not self.whole or value == int(value))


FINITE = Option("of a device of another package", -1e9, 1e9)
"""An option that is not of this project: any finite number of a size that can be computed with."""
_SWITCH = (0, 1, True)

OPTIONS = {
    "angle_rad": Option("size of the error or step, rad", -10, 10),
    "announced": Option("1: the jump is announced by the reset counter; 0: it is not", *_SWITCH),
    "answer_s": Option("extra time before an answer, s", 0, 60),
    "clock": Option("1: random time stamps", *_SWITCH),
    "code": Option("error code answered instead of silence; 0: silence", 0, 255, True),
    "confidence": Option(
        "what the camera calls its poses, 0 failed to 3 high; the poses stay true", 0, 3, True
    ),
    "delay_s": Option("by how much, s", 0, 60),
    "distance_m": Option("size of the step, m", -100, 100),
    "duty": Option("part of every period that is silent", 0, 1),
    "drift_x_m_s": Option("motion along wall x that is seen and is none, m/s", -10, 10),
    "drift_y_m_s": Option("the same along wall y", -10, 10),
    "drift_n_s": Option(
        "how fast the reported force leaves the true one, N/s; `factor` then does nothing", -1000, 1000
    ),
    "slow:factor": Option("of the output period", 1, 1000),
    "wrong:factor": Option("of what is sent", -10, 10),
    "adhesion_loss:factor": Option("of the fan's force", 0, 1),
    "flags": Option("status bits of the encoder chip to set, instead of random words", 0, 31, True),
    "force_n": Option("size of the step, N", -10_000, 10_000),
    "frame": Option("MAVLink number of the frame that poses claim", 0, 255, True),
    "nan": Option("1: NaN instead of random numbers", *_SWITCH),
    "occlude": Option("1: the body is out of sight; 0: no frame is sent", *_SWITCH),
    "offset_m": Option("along x, m", -100, 100),
    "offset_rad": Option("size of the error, rad", -10, 10),
    "over_s": Option("time in which the fan's force goes down along a line, s", 0, 3600),
    "packets": Option("1: random packets", *_SWITCH),
    "period_s": Option("length of a period, s", 0.001, 3600),
    "probability": Option("of each message", 1e-6, 1),
    "quality": Option("what the computer calls its poses; the poses stay true", -1, 100, True),
    "rate_rad_s": Option("added to every axis of the gyroscope, rad/s", -100, 100),
    "share": Option(
        "of the motor's turns that reach the wheel: its hub slips; `angle_rad` then does nothing", 0.05, 1
    ),
    "speed_rpm": Option("size of the step of the reported speed, 1/min", -200_000, 200_000),
    "steps": Option("of the throttle's 180 steps, added once", -180, 180, True),
    "scale": Option("factor on every step seen", -10, 10),
}
"""By name, or `KIND:NAME` where it means something else for every kind of fault."""


def option_of(kind: str, name: str) -> Option:
    """What an option of a kind of fault may be."""
    return OPTIONS.get(f"{kind}:{name}") or OPTIONS.get(name) or FINITE
