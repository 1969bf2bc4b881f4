"""Intel RealSense T265 on USB."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.config.tracker import FeedEndpoint, T265Config
from hil.devices.looks import Watched
from hil.vocabulary.clock import Clock
from hil.vocabulary.errors import HilError
from hil.vocabulary.finding import Finding, Level
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import Connection, DeviceModel, Found, Search
from hil.vocabulary.signals import TrackerSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting

_FIRMWARE_S = 10.0
_USB_IDS = {("03e7", "2150"), ("8087", "0b37")}  # before and after it was given its firmware


def _driver(config: T265Config, clock: Clock, pipeline: Any = None) -> Sensor[TrackerSample]:
    from hil.drivers.tracker import T265Tracker

    return T265Tracker(config, clock, pipeline=pipeline)


def _imperfections() -> type[Any]:
    from hil.fakes.tracker import TrackerTruthOptions

    return TrackerTruthOptions


def _emulate(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import Wired
    from hil.fakes.tracker import T265 as Camera
    from hil.fakes.tracker import TrackerFace, TrackerTruthOptions

    config: T265Config = setting.config
    camera = Camera(
        setting.world,
        options=setting.options(TrackerTruthOptions),
        mount_position_m=config.mount_position_m,
        mount_rotation_wxyz=config.mount_rotation_wxyz,
    )
    return Wired(lambda: Connection(parts={"pipeline": camera.pipeline()}), lambda: TrackerFace(camera))


def _reach(endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"endpoint": FeedEndpoint(host=endpoint["host"], port=endpoint["port"])}


def _search(search: Search) -> Found | None:
    """The camera that its library sees, where there is one; without the library nobody is asked."""
    from hil.drivers.tracker.library import find_camera, realsense

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


def _plugged_in(sysfs: Path) -> bool:
    """Whether USB shows a T265, with or without firmware; yes where the system does not tell."""
    if not (sysfs / "bus").is_dir():
        return True
    ids = set()
    for one in (sysfs / "bus/usb/devices").glob("*"):
        with contextlib.suppress(OSError):
            ids.add(tuple((one / key).read_text().strip() for key in ("idVendor", "idProduct")))
    return bool(ids & _USB_IDS)


def _look(watched: Watched) -> Iterator[Finding]:
    """Its firmware: the library gives it one whenever it is plugged in; another one is another library's."""
    config: T265Config = watched.config
    found, expected = watched.device.identity().get("firmware", "unknown"), " or ".join(config.firmware)
    right = found in config.firmware
    level: Level = "ok" if right else "warning" if found == "unknown" else "failure"
    remedy = (
        "install pyrealsense2 2.53.1, which brings 0.2.0.951, and plug the camera out and in again; or, if "
        f'this one was tried, tracker.firmware = ["{found}"]'
    )
    yield Finding("tracker", "firmware", level, found, expected, "" if right else remedy)


T265 = DeviceModel(
    kind="tracker",
    name="t265",
    title="Intel RealSense T265 on USB",
    config=T265Config,
    driver=_driver,
    emulate=_emulate,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
    look=_look,
)
