"""A further device of a kind under its own name: what its driver raises and logs names it."""

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
        kind: by whose name the code calls the device.
        name: of the device on the bench.
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
    """What makes a driver that calls itself by the device's name, as far as it uses its `name`."""

    def made() -> Device:
        device = make()
        with suppress(AttributeError):
            device.name = name
        return device

    return made


class OwnName(Device):
    """A driver whose errors name the device.

    To set the driver's `name` is not enough: it hands its name to its parts when it is made, and one of
    another package may write the kind's name into its errors.

    Args:
        driver: of the device, which calls itself by the name of its kind.
        kind: that name.
        name: of the device on the bench.
    """

    def __init__(self, driver: Device, kind: str, name: str) -> None:
        self._driver, self._named, self.name = driver, functools.partial(named, kind, name), name

    def open(self) -> None:
        """As of the driver."""
        with self._named():
            self._driver.open()

    def close(self) -> None:
        """As of the driver."""
        self._driver.close()

    def identity(self) -> Mapping[str, str]:
        """As of the driver."""
        with self._named():
            return self._driver.identity()

    def read(self) -> Any:
        """As of the driver."""
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
