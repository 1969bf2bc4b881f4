"""Decides when a camera that alone sees a stopped robot move does not count."""

from collections.abc import Collection

from hil.core.clock import nanoseconds

CAMERA, CAPTURE = "tracker", "mocap"
_CONTRADICTS_NS = nanoseconds(2.0)
"""Duration of the contradiction: the slowest motion that a camera sees is 10 mm by then."""


class CameraVote:
    """Weighs a camera that moves against all other sensors at rest.

    A camera's position is the sum of small motions, which drifts; motion capture measures from outside. So
    the camera is outvoted by motion capture, wheels, IMU and a confirmed force together. Motion capture that
    moves is never outvoted: a camera may show a slow slide as rest.

    Attributes:
        decided: True once the camera was outvoted.
    """

    def __init__(self) -> None:
        self.decided = False
        self._since_ns: int | None = None

    def begin(self) -> None:
        """Begin a check."""
        self._since_ns = None

    def follow(self, t_ns: int, moving: Collection[str], places: Collection[str], *, confirmed: bool) -> bool:
        """Process one look; returns whether the camera is outvoted from now on.

        Args:
            t_ns: time of the look.
            moving: trusted sensors that show motion.
            places: trusted sensors that would detect a slide.
            confirmed: True if two measurements agree on the force.
        """
        if {*moving} - {CAMERA} or CAPTURE not in places or not confirmed:
            self._since_ns = None
        elif moving:
            self._since_ns = t_ns if self._since_ns is None else self._since_ns
            self.decided = t_ns - self._since_ns >= _CONTRADICTS_NS
        return self.decided

    def in_words(self) -> str:
        """Text that the camera does not count; empty if it was not outvoted."""
        others = "motion capture, servos, IMU and the measured force contradict it"
        return f"; the camera, which still moves, does not count: {others}" if self.decided else ""
