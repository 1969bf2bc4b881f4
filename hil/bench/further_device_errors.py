"""Puts the name of a further device into the errors and logs of its driver."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from hil.core.errors import DeviceError
from hil.core.interfaces import Device


@contextmanager
def named(kind: str, name: str) -> Iterator[None]:
    """Run code of a device; errors that name its kind name the device instead.

    Args:
        kind: name of the kind that the code uses for the device.
        name: the device's name on the bench.
    """
    try:
        yield
    except DeviceError as error:
        if error.device == kind != name:
            error.device = name
            error.message = name + error.message.removeprefix(kind)
            error.args = (name + str(error.args[0]).removeprefix(kind), *error.args[1:])
        raise


def making(make: Callable[[], Device], name: str) -> Callable[[], Device]:
    """Wrap a driver factory so that the driver's `name` is the device's name."""

    def made() -> Device:
        device = make()
        with suppress(AttributeError):
            device.name = name
        return device

    return made


class OwnName(Device):
    """A driver whose errors name the device.

    Setting the driver's `name` is not enough: the driver passes its name to its parts when it is made, and a
    driver of another package may write the kind's name into its errors.

    Args:
        driver: driver of the device, which uses the name of the kind.
        kind: name of the kind.
        name: the device's name on the bench.
    """

    def __init__(self, driver: Device, kind: str, name: str) -> None:
        self._driver, self._named, self.name = driver, functools.partial(named, kind, name), name

    def open(self) -> None:
        """Open the driver."""
        with self._named():
            self._driver.open()

    def close(self) -> None:
        """Close the driver."""
        self._driver.close()

    def identity(self) -> Mapping[str, str]:
        """Identity that the driver reports."""
        with self._named():
            return self._driver.identity()

    def read(self) -> Any:
        """Sample or samples of the driver."""
        driver: Any = self._driver
        with self._named():
            return driver.read()

    def __getattr__(self, name: str) -> Any:
        """Give all other attributes of the driver."""
        if name.startswith("_"):
            raise AttributeError(name)
        found = getattr(self._driver, name)
        if not callable(found):
            return found

        @functools.wraps(found)
        def call(*given: Any, **more: Any) -> Any:
            with self._named():
                return found(*given, **more)

        return call
