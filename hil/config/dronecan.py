"""Configuration of a fan whose controller speaks DroneCAN (`[adhesion]`, `model = "dronecan"`)."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from hil.config.adhesion import MotorConfig
from hil.config.can_bus import Claim
from hil.config.field_types import Within

_NODE = "DroneCAN node"
NodeId = Annotated[int, Within(1, 127, "node ids of DroneCAN")]


class DroneCanConfig(MotorConfig):
    """A motor controller that obeys `esc.RawCommand` and sends `esc.Status`: a VESC in that mode, or another.

    Attributes:
        command: `duty` (`RawCommand`) or `rpm` (`RPMCommand`).
        node_id: node id of the controller.
        esc_index: index of the controller in the commands; `UAVCAN ESC Index` in VESC Tool.
        own_id: node id of the daemon; no other node may have it.
    """

    model: Literal["dronecan"] = "dronecan"
    command: Literal["duty", "rpm"] = "duty"
    node_id: NodeId = 42
    esc_index: Annotated[int, Within(0, 2, "this driver sends three commands at most")] = 0
    own_id: NodeId = 120

    def claims(self) -> Iterable[Claim]:
        """The node ids of the controller and of the daemon."""
        return (Claim("node_id", _NODE, self.node_id), Claim("own_id", _NODE, self.own_id))

    def daemon_spec(self) -> dict[str, Any]:
        """The specification for any motor controller, less its highest current: no current is commanded."""
        common = super().daemon_spec()
        highest = {name: value for name, value in common["highest"].items() if name != "current_a"}
        details = {"esc_index": self.esc_index, "node_id": self.own_id, "rpm_per_v": self.rpm_per_v}
        return {
            **common,
            "controller_id": self.node_id,
            "protocol": "dronecan",
            "details": details,
            "highest": highest,
        }
