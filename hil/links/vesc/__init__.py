"""The CAN interface of a VESC motor controller; `vesc.dbc` describes the same frames."""

from pathlib import Path

from hil.links.vesc.messages import (
    ALL_SERVOS,
    HIGHEST_ID,
    CanFrame,
    Message,
    Order,
    Packet,
    Pong,
    Status,
    Status2,
    Status3,
    Status4,
    Status5,
    Status6,
    address,
    decode,
    order_frame,
    ping_frame,
)

__all__ = [
    "ALL_SERVOS",
    "DBC",
    "HIGHEST_ID",
    "CanFrame",
    "Message",
    "Order",
    "Packet",
    "Pong",
    "Status",
    "Status2",
    "Status3",
    "Status4",
    "Status5",
    "Status6",
    "address",
    "decode",
    "order_frame",
    "ping_frame",
]

DBC = Path(__file__).with_name("vesc.dbc")
"""The frames for cantools and the like, of a controller with id 0: add the id to each identifier."""
