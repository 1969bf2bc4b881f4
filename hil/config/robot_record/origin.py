"""Checks before a result enters a robot's record: which robot it is of, and how its run ended.

A part says both in tables of its own. A piece of a bench file says it in comments, so that it can still be
copied into one. A `result.json` beside either overrides how the run ended.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil.config.robot_record.folder import check_robot_is
from hil.config.robot_record.parts import NOT_VERIFIED, Identity
from hil.core.errors import ConfigError, DataError, reason_of
from hil.core.result_names import PASSED, RESULT
from hil.support.file_reading import MOST_TOML_BYTES, json_value, read_json, read_text

FROM_A_FILE = "taken from a file"
_ROBOT = re.compile(r"^# robot = (\{.*\})$", re.MULTILINE)
_VERDICT = re.compile(r'^# verdict = "(.*)"\n', re.MULTILINE)


@dataclass(frozen=True)
class Origin:
    """Origin of a file.

    Attributes:
        robot: robot that it is of; None if the file does not name one.
        verdict: verdict of the run that wrote it; `not verified` if unknown.
        procedure: name of that run's procedure; `taken from a file` if unknown.
    """

    robot: Identity | None
    verdict: str
    procedure: str

    def must_have_passed(self, path: Path) -> None:
        """Refuse the result of a run that did not pass; raises `ConfigError` that names the file."""
        if self.verdict not in (*PASSED, NOT_VERIFIED):
            raise ConfigError(
                f"{path}: left by a run that ended in {self.verdict}; nothing of it was applied",
                expected="a run that passed",
                remedy=f"look at the run's page, fix what failed, and run {self.procedure} again",
            )

    def must_be_of(self, robot: Identity, path: Path, *, of_this_robot: bool) -> None:
        """Refuse the result of another robot.

        Args:
            robot: robot that is to use it.
            path: path of the file.
            of_this_robot: True if the user confirms that a file without an identity is of this robot.

        Raises:
            ConfigError: it is of another robot, or of an unknown one without that confirmation.
        """
        if self.robot is not None:
            check_robot_is(
                self.robot,
                robot,
                f"{path}: of another robot; nothing of it was applied",
                "take a file that was measured on this robot, or name the bench file of that one",
                "in the file",
            )
        elif not of_this_robot:
            raise ConfigError(
                f"{path}: does not say of which robot it is; nothing of it was applied",
                expected=f"a file that was measured on {robot.name!r} and says so",
                remedy="measure it again; or, if you know that it is of this robot, add --of-this-robot",
            )


def comment(robot: Identity) -> str:
    """Comment line for a piece of a bench file that names its robot."""
    return f"# robot = {json.dumps(robot.model_dump(mode='json', exclude_none=True))}\n"


def with_verdict(text: str, verdict: str) -> str:
    """A piece of a bench file that says how its run ended, in place of what it said before."""
    return f'# verdict = "{verdict}"\n{_VERDICT.sub("", text)}'


def of_fragment(path: Path) -> Origin:
    """Origin of a piece of a bench file, by its comments; raises `ConfigError` for wrong comments."""
    try:
        text = read_text(path, MOST_TOML_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({reason_of(error)})") from None
    reported, verdict = _ROBOT.search(text), _VERDICT.search(text)
    robot = None if reported is None else _robot(path, reported[1])
    return _by_the_result(path, Origin(robot, NOT_VERIFIED if verdict is None else verdict[1], FROM_A_FILE))


def of_part(path: Path, tree: Mapping[str, Any]) -> Origin:
    """Origin of a part, by its tables; raises `ConfigError` for a robot that cannot be meant."""
    robot = None if "robot" not in tree else _robot(path, tree["robot"])
    said = Origin(robot, str(tree.get("verdict", NOT_VERIFIED)), str(tree.get("procedure", FROM_A_FILE)))
    return _by_the_result(path, said)


def _robot(path: Path, given: object) -> Identity:
    try:
        return Identity.model_validate(json_value(given) if isinstance(given, str) else given)
    except (ValidationError, ValueError):
        raise ConfigError(
            f"{path}: robot: it cannot be read of which robot this is", remedy="measure it again"
        ) from None


def _by_the_result(path: Path, said: Origin) -> Origin:
    """An origin corrected by the result that lies beside the file."""
    beside = path.parent / RESULT
    if not beside.is_file():
        return said
    try:
        tree = read_json(beside)
        return Origin(said.robot, str(tree["verdict"]), str(tree["procedure"]))
    except (DataError, KeyError, TypeError):
        return Origin(said.robot, NOT_VERIFIED, said.procedure)
