"""Intel RealSense T265 on USB."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil.config.tracker import FeedEndpoint, T265Config
from hil.core.device import DeviceModel, Found, Search
from hil.core.errors import HilError
from hil.core.finding import Finding, Level
from hil.drivers.doctor_watch import Watched

_FIRMWARE_S = 10.0
_USB_IDS = {("03e7", "2150"), ("8087", "0b37")}  # before and after its firmware is loaded


class T265(DeviceModel):
    """The T265, reached through its maker's library; the emulated camera replaces the library's pipeline."""

    kind, name, title = "tracker", "t265", "Intel RealSense T265 on USB"
    config, wire = T265Config, "poses"
    emulation = "hil.fakes.tracker.t265.connection:emulated"
    driver, chip = "hil.drivers.tracker.t265.driver:T265Tracker", "hil.fakes.tracker.t265.chip:T265"

    def connection(self, endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
        """Address of the process that serves the emulated camera."""
        return {"endpoint": FeedEndpoint(host=endpoint["host"], port=endpoint["port"])}

    def search(self, search: Search) -> Found | None:
        """Find the camera by its library, where the library is installed."""
        from hil.drivers.tracker.t265.librealsense_interface import find_camera, realsense

        try:
            library = realsense("tracker")
        except HilError as error:
            search.say(f"{error.message}; {error.remedy}")
            return None
        patience_s = _FIRMWARE_S if _plugged_in(search.sysfs) else 0.0
        waits = " (it may load its firmware for some seconds)" if patience_s else ""
        search.say(f"looking for a camera{waits}")
        try:
            _, serial_number = find_camera(library, "tracker", search.clock, patience_s)
        except HilError as error:
            search.say(error.message)
            return None
        return Found({"serial": serial_number})

    def check(self, watched: Watched) -> Iterator[Finding]:
        """Finding on the firmware, which the library loads whenever the camera is plugged in."""
        config: T265Config = watched.config
        found, expected = watched.device.identity().get("firmware", "unknown"), " or ".join(config.firmware)
        right = found in config.firmware
        level: Level = "ok" if right else "warning" if found == "unknown" else "failure"
        remedy = (
            "install pyrealsense2 2.53.1, which brings 0.2.0.951, and plug the camera out and in again; or, "
            f'if this one was tried, tracker.firmware = ["{found}"]'
        )
        yield Finding("tracker", "firmware", level, found, expected, "" if right else remedy)


def _plugged_in(sysfs: Path) -> bool:
    """Whether USB lists a T265, with or without firmware; True where the system has no such list."""
    if not (sysfs / "bus").is_dir():
        return True
    ids = set()
    for one in (sysfs / "bus/usb/devices").glob("*"):
        with contextlib.suppress(OSError):
            ids.add(tuple((one / key).read_text().strip() for key in ("idVendor", "idProduct")))
    return bool(ids & _USB_IDS)
