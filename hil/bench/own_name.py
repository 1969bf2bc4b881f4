"""A further device of a kind under its own name: what its driver raises names it, and not the first one."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from hil.vocabulary.errors import DeviceError
from hil.vocabulary.interfaces import Device


class OwnName(Device):
    """A driver whose errors name the device.

    Args:
        driver: of the device, which calls itself by the name of its kind.
        kind: that name.
        name: of the device on the bench.
    """

    def __init__(self, driver: Device, kind: str, name: str) -> None:
        self._driver, self._kind, self.name = driver, kind, name

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Run code of the driver; its errors get the device's name where they have the kind's."""
        try:
            yield
        except DeviceError as error:
            if error.device == self._kind:
                error.device = self.name
                error.message = self.name + error.message.removeprefix(self._kind)
                error.args = (self.name + str(error.args[0]).removeprefix(self._kind), *error.args[1:])
            raise

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
        """Whatever else the driver has."""
        if name.startswith("_"):
            raise AttributeError(name)
        found = getattr(self._driver, name)
        if not callable(found):
            return found

        @functools.wraps(found)
        def call(*given: Any, **named: Any) -> Any:
            with self._named():
                return found(*given, **named)

        return call
