"""A driver that runs within a context: its errors name the device, or what it opens has faults."""

import functools
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

from hil.core.interfaces import Device


class DeviceWithin(Device):
    """A driver, each of whose functions but `close` runs within a context.

    Args:
        driver: driver of the device.
        within: maker of the context.
        name: the device's name on the bench.
    """

    def __init__(self, driver: Device, within: Callable[[], AbstractContextManager[None]], name: str) -> None:
        self._driver, self._within, self.name = driver, within, name

    def open(self) -> None:
        """Open the driver."""
        with self._within():
            self._driver.open()

    def close(self) -> None:
        """Close the driver."""
        self._driver.close()

    def identity(self) -> Mapping[str, str]:
        """Identity that the driver reports."""
        with self._within():
            return self._driver.identity()

    def read(self) -> Any:
        """Sample or samples of the driver."""
        driver: Any = self._driver
        with self._within():
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
            with self._within():
                return found(*given, **more)

        return call
