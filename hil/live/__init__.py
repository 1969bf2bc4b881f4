"""The live loop: a bench at a fixed rate in real time, commanded from outside, watched and recorded."""

from hil.live.reference_files import load_trajectory
from hil.live.session import LivePlan, LiveSession
from hil.live.velocity_input import CommandLines, StdinLines, UdpLines, open_commands
from hil.live.velocity_reference import VelocityReference

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
