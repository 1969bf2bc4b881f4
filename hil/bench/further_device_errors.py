"""Puts the name of a further device into the errors and logs of its driver."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from hil.core.errors import DeviceError
from hil.core.interfaces import Device


@contextmanager
def named(kind: str, name: str) -> Iterator[None]:
    """Run code of a device; errors that name its kind name the device instead.

    Setting the driver's `name` is not enough: the driver passes its name to its parts when it is made, and a
    driver of another package may write the kind's name into its errors.

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
