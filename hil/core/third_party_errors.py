"""Turns exceptions from code of another package into errors that name the package.

Exceptions from code of this project stay unchanged: they are defects, and need their traceback.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from hil.core.call_chain import place_of
from hil.core.errors import ConfigError, DeviceError, HilError, error_text

OURS = "hil"
T = TypeVar("T")


class PackageError(DeviceError):
    """Code of a package that adds a device has failed; `kind` is the device's kind."""

    def __init__(self, kind: str, package: str, message: str, *, expected: str = "") -> None:
        self.kind = kind
        super().__init__(
            f"{kind} ({package})",
            message,
            expected=expected,
            remedy=f"fix {package.split()[0]}, or install a version of it without this",
        )


@contextmanager
def of_a_script(what: str) -> Iterator[None]:
    """Run a user's function; an exception other than a `HilError` becomes a `ConfigError`.

    Args:
        what: the code that runs, for example `measurements of procedure square`.
    """
    try:
        yield
    except (HilError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise ConfigError(
            f"{what}: {error_text(error)} ({place_of(error)})", remedy="fix the script there"
        ) from error


@contextmanager
def errors_as_package_error(kind: str, package: str, what: str) -> Iterator[None]:
    """Run code of a package; an exception other than a `HilError` becomes a `PackageError`.

    Args:
        kind: the device's kind.
        package: name and version, as in `DeviceKind.package` and `DeviceModel.package`.
        what: the code that runs, for example `read()`.

    Raises:
        PackageError: naming kind, package, what was run and the exception.
    """
    try:
        yield
    except HilError:
        raise
    except (Exception, SystemExit, GeneratorExit) as error:
        if package == OURS:
            raise
        raise PackageError(kind, package, f"{what} raised {error_text(error)}") from error


def call_in_package(kind: str, package: str, what: str, call: Callable[..., T], *given: Any) -> T:
    """Call a function of a package and return its result; exceptions as in `errors_as_package_error`."""
    with errors_as_package_error(kind, package, what):
        return call(*given)
