"""Driver of an OptiTrack motion capture system over NatNet."""

from hil.drivers.mocap.driver import NatNetMocap
from hil.drivers.mocap.udp_ports import Datagram, DatagramFactory, DatagramPort

__all__ = ["Datagram", "DatagramFactory", "DatagramPort", "NatNetMocap"]
