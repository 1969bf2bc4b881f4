"""The emulated motion capture server (OptiTrack Motive, NatNet)."""

from hil.fakes.mocap.face import NatNetFace
from hil.fakes.mocap.options import STILL, MocapTruthOptions
from hil.fakes.mocap.server import SUPPORTED_FAULTS, NatNetServer

__all__ = ["STILL", "SUPPORTED_FAULTS", "MocapTruthOptions", "NatNetFace", "NatNetServer"]
