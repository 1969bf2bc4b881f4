"""The live loop: a bench at a fixed rate in real time, commanded from outside, watched and recorded."""

from hil.live.commands import CommandLines, StdinLines, UdpLines, open_commands
from hil.live.references import load_trajectory
from hil.live.session import LivePlan, LiveSession
from hil.live.velocity import VelocityReference

__all__ = [
    "CommandLines",
    "LivePlan",
    "LiveSession",
    "StdinLines",
    "UdpLines",
    "VelocityReference",
    "load_trajectory",
    "open_commands",
]
