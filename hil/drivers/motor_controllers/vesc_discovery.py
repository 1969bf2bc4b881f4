"""Discovers VESCs on CAN buses that were named, or that the system has."""

from collections.abc import Iterable, Iterator
from typing import TypeVar

from hil.config.adhesion import VescConfig
from hil.config.can_bus import SEARCH_S, CanConfig
from hil.core.device import Search
from hil.core.errors import HilError

C = TypeVar("C", bound=CanConfig)


def controllers(search: Search, buses: Iterable[C]) -> Iterator[tuple[C, list[int]]]:
    """Yield each bus with controllers that answer a ping or send reports, and their ids.

    A bus on which a daemon commands a fan or propellers is only listened to.
    """
    from hil.drivers.motor_controllers.vesc_identity import discover_controllers
    from hil.drivers.motor_controllers.vesc_settings import Answers
    from hil.fan_daemon.server import is_on, running_daemons
    from hil.links.can_bus import CanLink

    for bus in buses:
        busy = any(is_on(name, bus.bus) for name in running_daemons())
        search.say(f"{'listening' if busy else 'asking'} for VESCs on {bus.interface}:{bus.channel}")
        query = VescConfig(
            interface=bus.interface,
            channel=bus.channel,
            bitrate=bus.bitrate,
            options=bus.options,
            open_timeout_s=SEARCH_S,
        )
        link = CanLink("adhesion", query, search.clock)
        try:
            link.open()
            seen = discover_controllers(link, query, search.clock, Answers(), listen_only=busy)
        except HilError as error:
            search.say(str(error))
            continue
        finally:
            link.close()
        if ids := sorted({*seen.pongs, *seen.statuses}):
            yield bus, ids
