"""Where a device is connected, by its table of the bench file."""

from pydantic import BaseModel

_PLACES = ("port", "channel", "server", "address", "serial")
"""Keys of the bench file for the address of a device."""


def device_place(device: BaseModel) -> str:
    """The port, bus, address or serial number of a device; empty where its table names none.

    Args:
        device: the device's table.
    """
    return next((str(value) for key in _PLACES if (value := getattr(device, key, None))), "")
