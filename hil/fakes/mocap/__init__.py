"""The emulated motion capture server (OptiTrack Motive, NatNet)."""

from hil.fakes.mocap.capture_truth import STILL, MocapTruthOptions
from hil.fakes.mocap.motive_server import SUPPORTED_FAULTS, NatNetServer
from hil.fakes.mocap.natnet_udp import NatNetTransport

__all__ = ["STILL", "SUPPORTED_FAULTS", "MocapTruthOptions", "NatNetServer", "NatNetTransport"]
