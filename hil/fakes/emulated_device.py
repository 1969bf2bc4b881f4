"""Builds and connects an emulated device: in this process for virtual time, or at the wire.

A model's `emulate` takes an `EmulationRequest` and gives an `EmulatedDevice`. Most are a chip behind a serial
line (`on_serial_line`) or on a CAN bus (`hil.fakes.emulated_can`); the others define both connections.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from hil.core.device import Connection, import_object
from hil.fakes.emulation_request import EmulationRequest
from hil.fakes.serial_chip import SerialChip
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.server import Transport

__all__ = ["EmulatedDevice", "EmulationRequest", "Transport", "Wired", "on_serial_line"]

_LATENCY_S = 0.001
"""Latency timer of a USB adapter as its driver is best set."""


class EmulatedDevice(Protocol):
    """An emulated device without a connection yet. Call `connect` or `serve`, once."""

    @abstractmethod
    def connect(self) -> Connection:
        """Make it reachable in this process, on the virtual clock."""

    @abstractmethod
    def serve(self) -> Transport:
        """Make it reachable for any client, in real time."""


@dataclass
class Wired(EmulatedDevice):
    """An emulated device whose two kinds of connection are given as functions."""

    connecting: Callable[[], Connection]
    serving: Callable[[], Transport]

    def connect(self) -> Connection:
        """Connection in this process, as of `EmulatedDevice.connect`."""
        return self.connecting()

    def serve(self) -> Transport:
        """Server for clients, as of `EmulatedDevice.serve`."""
        return self.serving()


@dataclass
class SerialWired(EmulatedDevice):
    """A chip at the far end of a serial line: `hil://NAME`, or a PTY."""

    line: SerialLine
    printed: Mapping[str, object] = field(default_factory=dict)

    def connect(self) -> Connection:
        """Serve the line in process, as a pyserial URL."""
        self.line.chip.begin_in_use()
        line = self.line.open()
        return Connection({"port": f"hil://{line.name}"}, close=line.close)

    def serve(self) -> Transport:
        """Serve the line to other processes, as a PTY."""
        return SerialPty(self.line, dict(self.printed))


def behind_adapter(model: Any, request: EmulationRequest) -> EmulatedDevice:
    """The chip of a `hil.drivers.serial_and_can_models.SerialModel` behind a USB serial adapter.

    Args:
        model: model whose `chip` has `build(request)`.
        request: its world and its table of the bench file.
    """
    config, chip = request.config, import_object(model.chip).build(request)
    printed = {key: getattr(config, key) for key in model.printed if hasattr(config, key)}
    latency_s = getattr(config, "usb_latency_s", _LATENCY_S)
    return on_serial_line(request, chip, latency_s=latency_s, printed=printed)


def on_serial_line(
    request: EmulationRequest,
    chip: SerialChip,
    *,
    latency_s: float = _LATENCY_S,
    printed: Mapping[str, object] | None = None,
) -> EmulatedDevice:
    """A chip behind a USB serial adapter.

    Args:
        request: its world and its table of the bench file.
        chip: chip at the far end of the line.
        latency_s: latency timer of the adapter.
        printed: values that `hil emulate` prints beside the port; the table's baud rate by default.
    """
    line = SerialLine(request.world, chip, name=request.name, latency_s=latency_s)
    if printed is None:
        printed = {"baud": request.config.baud} if hasattr(request.config, "baud") else {}
    return SerialWired(line, printed)
