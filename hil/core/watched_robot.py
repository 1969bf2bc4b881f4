"""A robot that is watched while no control loop runs: what is seen of it, and in words."""

from dataclasses import dataclass


@dataclass(frozen=True)
class WatchedRobot:
    """What is seen of a robot while no control loop runs, until it is held.

    Attributes:
        why: reason for which the loop was stopped; empty before the first loop, and after a planned end.
        doubt: reason why the robot does not count as held yet; empty where nothing speaks against it.
        rest_s: time for which the wheels have been at rest by the servos, s; None where they turn, or are not
            seen.
    """

    why: str
    doubt: str
    rest_s: float | None

    def __str__(self) -> str:
        loop = f"the loop has stopped: {self.why}; " if self.why else "no loop runs: "
        rest = "the wheels are not seen at rest yet"
        if self.rest_s is not None:
            rest = f"its wheels have been at rest for {self.rest_s:.1f} s by the servos"
        return f"{loop}the robot is being watched; {rest}" + (
            f"; not held yet: {self.doubt}" if self.doubt else ""
        )
