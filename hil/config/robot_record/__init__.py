"""The record of a robot: everything that procedures found out about it, in versions that can be taken back.

A folder with the version in place (`record.toml`), every version (`history/`), and the files that they name
(`files/`). A bench file names it (`[record] folder`), and then runs with what it says.
"""

from hil.config.robot_record.folder import History, KeptVersion, NewPart, RobotRecord
from hil.config.robot_record.parts import PARTS, Confirmation, Figure, Identity, Part, RecordFile, Spread

__all__ = [
    "PARTS",
    "Confirmation",
    "Figure",
    "History",
    "Identity",
    "KeptVersion",
    "NewPart",
    "Part",
    "RecordFile",
    "RobotRecord",
    "Spread",
]
