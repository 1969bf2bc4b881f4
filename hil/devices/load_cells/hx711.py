"""Two load cells on HX711 converters: their counts on CAN, or as lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hil.config.can_bus import SEARCH_S
from hil.config.load_cells import CanCellsConfig, LineCellsConfig
from hil.vocabulary.clock import Clock
from hil.vocabulary.interfaces import Sensor
from hil.vocabulary.kinds import DeviceModel, Found, Search, opens
from hil.vocabulary.signals import LoadCellSample

if TYPE_CHECKING:
    from hil.devices.emulated import EmulatedDevice, Setting


def _on_can(config: CanCellsConfig, clock: Clock) -> Sensor[LoadCellSample]:
    from hil.drivers.load_cells import CanCells

    return CanCells(config, clock)


def _on_a_line(config: LineCellsConfig, clock: Clock) -> Sensor[LoadCellSample]:
    from hil.drivers.load_cells import LineCells

    return LineCells(config, clock)


def _imperfections() -> type[Any]:
    from hil.fakes.load_cells import LoadCellTruthOptions

    return LoadCellTruthOptions


def _emulate_on_can(setting: Setting) -> EmulatedDevice:
    from hil.devices.canbus import channel_of, on_can
    from hil.devices.emulated import Begun
    from hil.fakes.load_cells import CellNode, Cells, LoadCellTruthOptions

    config: CanCellsConfig = setting.config
    channel = channel_of(setting)
    cells = Cells(setting.world, config, setting.options(LoadCellTruthOptions))
    node = CellNode(setting.world, channel, config, cells)
    return Begun(on_can(setting, channel, subnet=165, dbc=config.dbc_path), node.begin_in_use)


def _emulate_line(setting: Setting) -> EmulatedDevice:
    from hil.devices.emulated import on_serial_line
    from hil.fakes.load_cells import CellLine, Cells, LoadCellTruthOptions

    cells = Cells(setting.world, setting.config, setting.options(LoadCellTruthOptions))
    return on_serial_line(setting, CellLine(setting.world, setting.config, cells))


def _reach(endpoint: Mapping[str, Any]) -> Mapping[str, Any]:
    from hil.devices.canbus import where

    return where(endpoint)


def _search(search: Search) -> Found | None:
    """Listen on the CAN buses that were named, or that the system has."""
    from hil.drivers.can_link import detected
    from hil.drivers.load_cells import CanCells

    given = [c for c in search.given.get("load_cells", ()) if isinstance(c, CanCellsConfig)]
    for config in given or detected(CanCellsConfig, open_timeout_s=SEARCH_S):
        search.say(f"listening for load cells on {config.interface}:{config.channel}")
        if opens(CanCells(config, search.clock)):
            return Found(config.table())
    return None


HX711_CAN = DeviceModel(
    kind="load_cells",
    name="hx711_can",
    title="two load cells on a CAN node",
    config=CanCellsConfig,
    driver=_on_can,
    emulate=_emulate_on_can,
    imperfections=_imperfections,
    search=_search,
    reach=_reach,
)

HX711_LINE = DeviceModel(
    kind="load_cells",
    name="hx711_line",
    title="two load cells on a serial line",
    config=LineCellsConfig,
    driver=_on_a_line,
    emulate=_emulate_line,
    imperfections=_imperfections,
)
