"""The error classes of the project and the exit code of each branch.

Every error that can reach a user derives from `HilError`. A leaf also inherits the builtin that a
Python reader would expect (`ValueError`, `OSError`, ...), carries the data needed to act on it, and
says what was found, what was expected and what to do. The command line turns it into one line on
stderr and `exit_code`; it never shows a traceback for one of these.
"""

import difflib
import logging
import math
import os
from collections.abc import Callable, Iterable
from numbers import Real
from pathlib import Path

from hil.core.rounding import digits_apart
from hil.core.stop_suspects import suspects_of

EXIT_PASS = 0
EXIT_LIMIT_FAILED = 1
EXIT_USAGE = 2
EXIT_DEVICE = 3
EXIT_ABORTED = 4
_LONGEST = 300


class HilError(Exception):
    """Root of every error raised on purpose.

    Args:
        message: description of the error, naming the file, key or device.
        expected: correct value, if that can be said.
        remedy: action that the user can take.
    """

    exit_code = EXIT_USAGE

    def __init__(self, message: str, *, expected: str = "", remedy: str = "") -> None:
        self.message = message
        self.expected = expected
        self.remedy = remedy
        parts = [message]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(parts))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the error unchanged, for the way from a worker process to its parent."""
        return _again, (type(self), self.args, self.__dict__)


def _again(kind: type[HilError], args: tuple[object, ...], carried: dict[str, object]) -> HilError:
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(carried)
    return error


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Hint ("did you mean ...?") with the known word nearest to a mistyped one; empty when none is near."""
    near = nearest(word, known)
    return f"did you mean {near}?" if near else ""


def did_you_mean_file(given: str | Path, known: Iterable[str]) -> str:
    """Hint as of `did_you_mean` for files, by their names without folder and ending, which many share."""
    by_stem = {Path(name).stem: name for name in known}
    near = nearest(Path(given).stem, by_stem)
    return f"did you mean {by_stem[near]}?" if near else ""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word nearest to a mistyped one; empty when none is near."""
    by_lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), by_lower, n=1)
    return by_lower[near[0]] if near else ""


def reason_of(error: Exception) -> str:
    """Error text of the system or a parser, without the error number and path of an `OSError`.

    An `OSError` from a library may have no system text; then its own text is used, or its class name.
    """
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def error_text(error: BaseException) -> str:
    """An exception in one line: its class and its message."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:_LONGEST]}" if text else type(error).__name__


class Aside:
    """Calls functions whose failure must end nothing else; logs each failure once."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def call(self, whose: str, act: Callable[[], object]) -> None:
        """Call a function of `whose`; never raises an exception."""
        try:
            act()
        except Exception as error:
            text = f"{whose} has failed: {error_text(error)}"
            if text not in self._told:
                self._told.add(text)
                logging.getLogger(__name__).warning(text)


class ConfigError(HilError, ValueError):
    """A configuration file or option is wrong; `problems` lists every fault found at once."""

    def __init__(
        self, message: str, *, problems: tuple[str, ...] = (), expected: str = "", remedy: str = ""
    ) -> None:
        self.problems = problems
        super().__init__(
            "\n  ".join((message, *problems)) if problems else message, expected=expected, remedy=remedy
        )


class UsageError(HilError, ValueError):
    """A command or a call is invalid (bad argument, bad combination)."""


def check_number(value: float, name: str, unit: str, *, above_zero: bool = False) -> None:
    """Refuse an argument that is not finite or is below zero.

    Args:
        value: value of the argument.
        name: name of the argument.
        unit: unit for the error message.
        above_zero: True to refuse zero as well.

    Raises:
        UsageError: naming argument, value and what was expected.
    """
    if isinstance(value, Real) and math.isfinite(value) and (value > 0 if above_zero else value >= 0):
        return
    least = "more than 0" if above_zero else "0 or more"
    raise UsageError(f"{name} is {value!r}", expected=f"a finite number of {unit}, {least}")


class DataError(HilError, ValueError):
    """A recording or another data file cannot be used; `path` names it."""

    def __init__(self, path: str, message: str, *, expected: str = "", remedy: str = "") -> None:
        self.path = path
        super().__init__(f"{path}: {message}" if path else message, expected=expected, remedy=remedy)


class TrajectoryError(HilError, ValueError):
    """A reference cannot be followed; carries the first offending time and value.

    Args:
        t_s: time on the trajectory, s.
        quantity: name with unit, for example `wheel speed (m/s)`.
        value: the offending value; `limit` is the limit that it was compared with.
    """

    def __init__(
        self,
        message: str,
        *,
        t_s: float,
        quantity: str,
        value: float,
        limit: float,
        remedy: str = "slow the motion down or change its shape",
    ) -> None:
        self.t_s, self.quantity, self.value, self.limit = t_s, quantity, value, limit
        digits = digits_apart(value, (limit,))
        super().__init__(
            f"{message}: {quantity} is {value:.{digits}g} at t = {t_s:.3f} s",
            expected=f"at most {limit:.4g}",
            remedy=remedy,
        )


class DeviceError(HilError, OSError):
    """A device cannot be used or has failed for good.

    Attributes:
        device: name of the device.
        port: its port; empty where it has none.
        what: description of the failure without device and port.
    """

    exit_code = EXIT_DEVICE

    def __init__(
        self, device: str, message: str, *, port: str = "", expected: str = "", remedy: str = ""
    ) -> None:
        self.device, self.port, self.what = device, port, message
        where = f"{device} at {port}" if port else device
        super().__init__(f"{where}: {message}", expected=expected, remedy=remedy)


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device repeatedly did not answer within its timeout."""


class FaultNotSupportedError(UsageError):
    """A requested fault is not modelled by the emulated device, or the device is real hardware."""


class SafetyStop(HilError, RuntimeError):
    """The supervisor stopped the robot.

    Attributes:
        reason: a short machine-readable word.
        suspects: kinds of devices that may be the cause; empty where none is known.
    """

    exit_code = EXIT_DEVICE

    def __init__(self, reason: str, message: str, suspects: Iterable[str] = ()) -> None:
        self.reason = reason
        self.suspects = tuple(dict.fromkeys((*suspects, *suspects_of(reason))))
        self._why = message
        super().__init__(f"robot stopped ({reason}): {message}")

    def after(self, first: str) -> "SafetyStop":
        """The same stop with a text before its message."""
        return SafetyStop(self.reason, f"{first}; {self._why}", self.suspects)


class Aborted(HilError, RuntimeError):
    """The operator or a signal ended the work; the robot is stopped on the way out."""

    exit_code = EXIT_ABORTED


class RecordingError(Aborted):
    """The results of a run can no longer be stored (disk full, read-only, too slow); `path` is the file."""

    def __init__(self, path: str, message: str, *, remedy: str = "") -> None:
        self.path = path
        super().__init__(f"{path}: {message}", remedy=remedy)


class DefectError(HilError):
    """An unexpected exception; its traceback is printed before its message."""

    exit_code = EXIT_ABORTED

    def __init__(self, what: str) -> None:
        super().__init__(
            f"{what}: a defect of this program",
            remedy="report it with the traceback on standard error and what hil info prints",
        )


class StepTimeoutError(HilError, TimeoutError):
    """A step or a teardown exceeded its time limit; the robot is stopped on the way out."""

    exit_code = EXIT_DEVICE

    def __init__(self, what: str, limit_s: float) -> None:
        self.what, self.limit_s = what, limit_s
        super().__init__(f"{what} took longer than {limit_s:g} s")


def shown_path(path: Path) -> str:
    """A path for messages and results: relative if below the current folder, else absolute."""
    try:
        here = os.getcwd()
    except OSError:  # the current folder was removed
        return str(path)
    whole = os.path.normpath(os.path.join(here, path))
    return os.path.relpath(whole, here) if whole.startswith(here.rstrip(os.sep) + os.sep) else whole
