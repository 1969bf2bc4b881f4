"""The USB tree as Linux shows it in `/sys`: which device is behind a port, on which hub, with what supply."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_SELF_POWERED = 0x40
_HUB_CLASS = "09"
HUB_BUDGET_MA = 500


@dataclass(frozen=True)
class UsbDevice:
    """A device on USB.

    Attributes:
        folder: in which the kernel describes it.
        vendor, product: ids, four hexadecimal digits each.
        serial: its serial number; empty where it has none.
        name: as it calls itself.
        speed_mbit: of its link; 0 if unknown.
    """

    folder: Path
    vendor: str
    product: str
    serial: str
    name: str
    speed_mbit: float

    @property
    def place(self) -> str:
        """Bus and ports: `1-2.3`."""
        return self.folder.name

    @property
    def may_sleep(self) -> bool:
        """Whether the kernel may suspend it."""
        return text_of(self.folder / "power/control") == "auto"

    def starved_by(self) -> tuple[str, int] | None:
        """A hub without supply on which it hangs, and what its devices ask for (mA), if that is too much."""
        hub = self.folder.parent
        powered = _number(text_of(hub / "bmAttributes"), 16)
        is_root = hub.name.startswith("usb")
        if is_root or text_of(hub / "bDeviceClass") != _HUB_CLASS or powered & _SELF_POWERED:
            return None
        asked = sum(_asks_ma(one) for one in hub.iterdir() if (one / "idVendor").is_file())
        return (hub.name, asked) if asked > HUB_BUDGET_MA else None


def behind(port: str, sysfs: Path) -> UsbDevice | None:
    """The USB device behind a serial port; None for other ports.

    Args:
        port: device path, or a link to one.
        sysfs: folder in which the kernel describes its devices.
    """
    if "://" in port:
        return None
    folder = (sysfs / "class/tty" / os.path.basename(os.path.realpath(port)) / "device").resolve()
    for one in (folder, *folder.parents):
        if (one / "idVendor").is_file():
            return read(one)
    return None


def plugged_in(ids: set[tuple[str, str]], sysfs: Path) -> list[UsbDevice]:
    """Devices with these ids (vendor, product)."""
    found = [read(one.resolve()) for one in sorted((sysfs / "bus/usb/devices").glob("*"))]
    return [device for device in found if (device.vendor, device.product) in ids]


def read(folder: Path) -> UsbDevice:
    """The kernel's description of one device."""
    vendor, product, serial, name, speed = (
        text_of(folder / key) for key in ("idVendor", "idProduct", "serial", "product", "speed")
    )
    return UsbDevice(folder, vendor, product, serial, name, float(_number(speed, 10)))


def text_of(path: Path) -> str:
    """A file of the kernel; empty where it cannot be read."""
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _asks_ma(folder: Path) -> int:
    return _number(text_of(folder / "bMaxPower").removesuffix("mA"), 10)


def _number(text: str, base: int) -> int:
    try:
        return int(text.partition(".")[0], base)
    except ValueError:
        return 0
