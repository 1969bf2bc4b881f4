"""Table of the formats of capture files, and the reading of one file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hil.datasets.capture_files import motive, qtm, trajectories, vicon
from hil.datasets.capture_files.poses import Poses

_HEAD = 4096


@dataclass(frozen=True)
class Format:
    """A format of capture files.

    Attributes:
        name: name of the format, for messages.
        up: axis that such files usually have upwards.
        is_it: function that tells by the first 4096 characters of a file whether it is of this format.
        read: function that reads the poses of each body from a file's name and text.
    """

    name: str
    up: str
    is_it: Callable[[str], bool]
    read: Callable[[str, str], Mapping[str, Poses]]


FORMATS = (
    Format(motive.NAME, motive.UP, motive.is_it, motive.read),
    Format(qtm.NAME, qtm.UP, qtm.is_it, qtm.read),
    Format(vicon.NAME, vicon.UP, vicon.is_it, vicon.read),
    Format(trajectories.EUROC, trajectories.UP, trajectories.is_euroc, trajectories.read_euroc),
    Format(trajectories.TUM, trajectories.UP, trajectories.is_tum, trajectories.read_tum),
)


def text_of(data: bytes) -> str:
    """Text of a file, without a byte order mark."""
    return data.decode("utf-8", "replace").removeprefix("\ufeff")


def format_of(data: bytes) -> Format | None:
    """Format of a file by its content; None for any other file."""
    head = text_of(data[:_HEAD])
    return next((one for one in FORMATS if one.is_it(head)), None)
