"""Driver of an OptiTrack motion capture system over NatNet."""

from hil.drivers.mocap.datagrams import Datagram, DatagramFactory, DatagramPort
from hil.drivers.mocap.sensor import NatNetMocap

__all__ = ["Datagram", "DatagramFactory", "DatagramPort", "NatNetMocap"]
