"""The fan behind a DroneCAN controller: identity, and `esc.Status` as samples."""

import math
from collections import Counter
from typing import Any

import can

from hil.config.dronecan import DroneCanConfig
from hil.core.clock import Clock, nanoseconds
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.finding import Finding
from hil.drivers.adhesion.motor_fan import Figures, MotorFan
from hil.fan_daemon.commander import MakeCommander, finding
from hil.fan_daemon.spec import Spec
from hil.links.can_bus import STANDARD_IDS, remedy_of_silence
from hil.links.dronecan.library import Receiver, frames_of, library
from hil.links.dronecan.messages import EscStatus, StatusReader
from hil.streams.steady_volts import SteadyVolts

_WAIT_S = 0.01
_ASK_NS = nanoseconds(0.1)
_KELVIN = 273.15
_MOST_LISTED = 8
_NODE = 0x7F
"""Bits of an identifier that name the node that sends the frame."""
_PRIORITY = 30


class DroneCanFan(MotorFan[DroneCanConfig]):
    """One fan; arguments as for `MotorFan`."""

    def __init__(
        self, config: DroneCanConfig, clock: Clock, make_commander: MakeCommander | None = None
    ) -> None:
        self._dronecan = library()
        self._node_info = ""
        super().__init__(config, clock, make_commander)

    def _forget(self) -> None:
        super()._forget()
        self._reader = StatusReader()
        self._volts = SteadyVolts()

    def _greet(self, spec: Spec) -> dict[str, str]:
        config = self._config
        nodes, indices, info = self._observed()
        if not nodes[config.node_id]:
            raise self._absent(sorted(nodes))
        ours = indices.get(config.esc_index, set())
        rivals = sorted(ours - {config.node_id})
        if rivals:
            raise DeviceError(
                self.name,
                f"nodes {config.node_id} and {rivals[0]} both have index {config.esc_index}: each would obey",
                port=self._link.port,
                expected="one",
                remedy="give each controller an index of its own (VESC Tool: UAVCAN ESC Index)",
            )
        if config.node_id not in ours:
            raise DeviceError(
                self.name,
                f"node {config.node_id} sends no esc.Status with index {config.esc_index}",
                port=self._link.port,
                expected="esc.Status",
                remedy="switch it on at 20 Hz or more, or set adhesion.esc_index",
            )
        self._node_info = info
        return {
            "model": info or "DroneCAN motor controller",
            "port": f"{self._link.port}, node {config.node_id}",
            "index": str(config.esc_index),
        }

    def _observed(self) -> tuple[Counter[int], dict[int, set[int]], str]:
        """Message count by node, nodes by ESC index, and the description that our node reports."""
        config, clock = self._config, self._clock
        receiver, nodes, indices, info = Receiver(), Counter[int](), dict[int, set[int]](), ""
        asked_ns, requests = -_ASK_NS, 0
        end_ns = clock.now_ns() + nanoseconds(config.open_timeout_s)
        least_ns = clock.now_ns() + nanoseconds(config.open_timeout_s / 3)
        while (now_ns := clock.now_ns()) < end_ns:
            if now_ns - asked_ns >= _ASK_NS and not info:
                asked_ns, requests = now_ns, requests + 1
                self._request_node_info(requests)
            for _, message in self._link.take(_WAIT_S):
                transfer = receiver.take(message.arbitration_id, bytes(message.data))
                if transfer is None or not message.is_extended_id:
                    continue
                payload, source = transfer.payload, transfer.source_node_id
                nodes[source] += 1
                kind = str(self._dronecan.get_dronecan_data_type(payload))
                if kind == "uavcan.equipment.esc.Status":
                    indices.setdefault(int(payload.esc_index), set()).add(source)
                elif kind == "uavcan.protocol.GetNodeInfo" and source == config.node_id:
                    info = info if transfer.request_not_response else _described(payload)
            if info and config.node_id in indices.get(config.esc_index, set()) and now_ns >= least_ns:
                break
        return nodes, indices, info

    def _request_node_info(self, transfer_id: int) -> None:
        request = self._dronecan.uavcan.protocol.GetNodeInfo.Request()
        for frame_id, data in frames_of(
            request,
            source=self._config.own_id,
            transfer_id=transfer_id % 32,
            priority=_PRIORITY,
            dest_node_id=self._config.node_id,
            service_not_message=True,
            request_not_response=True,
        ):
            self._link.send(frame_id, data, extended=True)

    def _absent(self, nodes: list[int]) -> DeviceError:
        node_id, port = self._config.node_id, self._link.port
        others = [n for n in nodes if n != self._config.own_id][:_MOST_LISTED]
        if others:
            return DeviceError(
                self.name,
                f"no node {node_id}; there: {', '.join(map(str, others))}",
                port=port,
                expected=f"node {node_id}",
                remedy=f"set adhesion.node_id = {others[0]} if that is the fan's",
            )
        return DeviceTimeoutError(
            self.name,
            f"no DroneCAN node answers{self._link.bus_errors()}",
            port=port,
            expected=f"node {node_id} at {self._config.bitrate} bit/s",
            remedy=remedy_of_silence(self.name, self._config, "the controller")
            + ", and that it speaks DroneCAN (VESC Tool: CAN Mode UAVCAN)",
        )

    def _is_own(self, key: int) -> bool:
        return key >= STANDARD_IDS and key & _NODE == self._config.node_id

    def _report(self, message: can.Message) -> EscStatus | None:
        report, config = self._reader.take(message.arbitration_id, message.data), self._config
        ours = report is not None and (report.node_id, report.index) == (config.node_id, config.esc_index)
        return report if ours and message.is_extended_id else None

    def _figures(self, report: EscStatus, t_ns: int) -> Figures:
        return Figures(
            speed_rpm=float(report.rpm),
            duty=self._sent_duty(),
            motor_a=math.nan,
            input_a=report.current_a,
            input_v=self._volts.take(report.voltage_v),
            fet_c=report.temperature_k - _KELVIN,
            motor_c=math.nan,
        )

    def _sent_duty(self) -> float:
        """The duty that the daemon sends, as this controller reports none; NaN if none is sent."""
        sent = None if self._commander is None else self._commander.status().get("sent")
        return float(sent[1]) if sent is not None and sent[0] == "duty" else math.nan

    def diagnose(self) -> tuple[Finding, ...]:
        """Findings on the identity, the settings and the daemon of the fan."""
        silent = "it does not report its timeout: the bench file says " + f"{self._config.timeout_s:g} s"
        return (
            Finding(
                self.name,
                "identity",
                "ok" if self._node_info else "warning",
                self._node_info or "not reported",
                "an answer to GetNodeInfo",
                "look at the node with `dronecan_gui_tool`",
            ),
            Finding(self.name, "timeout", "warning", silent, "1 s", "look at it in VESC Tool"),
            finding(self.name, self._commander),
        )


def _described(payload: Any) -> str:
    """Name and version of a node, from its answer."""
    version = payload.software_version
    name = bytes(payload.name.to_bytes()).decode(errors="replace")
    return f"{name} {version.major}.{version.minor}" if name else ""
