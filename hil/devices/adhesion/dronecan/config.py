"""Configuration of a fan whose controller speaks DroneCAN (`[adhesion]`, `model = "dronecan"`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import Field

from hil.config.adhesion import MotorConfig
from hil.config.can_bus import Claim

_NODE = "DroneCAN node"


class DroneCanConfig(MotorConfig):
    """A motor controller that obeys `esc.RawCommand` and sends `esc.Status`: a VESC in that mode, or another.

    Attributes:
        command: `duty` (`RawCommand`) or `rpm` (`RPMCommand`).
        node_id: of the controller.
        esc_index: its place in the commands; `UAVCAN ESC Index` in VESC Tool.
        own_id: node id of the keeper; no other node may have it.
    """

    model: Literal["dronecan"] = "dronecan"
    command: Literal["duty", "rpm"] = "duty"
    node_id: int = Field(42, ge=1, le=127)
    esc_index: int = Field(0, ge=0, le=2)
    own_id: int = Field(120, ge=1, le=127)

    def claims(self) -> Iterable[Claim]:
        """The controller's and the keeper's."""
        return (Claim("node_id", _NODE, self.node_id), Claim("own_id", _NODE, self.own_id))

    def keeper(self) -> dict[str, Any]:
        """As of any motor controller, which has no set-point of current here."""
        common = super().keeper()
        highest = {name: value for name, value in common["highest"].items() if name != "current_a"}
        details = {"esc_index": self.esc_index, "node_id": self.own_id, "rpm_per_v": self.rpm_per_v}
        return {
            **common,
            "controller_id": self.node_id,
            "dialect": "dronecan",
            "details": details,
            "highest": highest,
        }
