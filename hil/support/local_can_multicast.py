"""Restricts python-can's `udp_multicast` to the programs of one host: frames of other hosts are dropped.

python-can's own bus accepts every datagram that reaches its port, from any sender, sent to the group or not.
This bus uses the same format, so both can communicate. It is bound to the group, sends nothing beyond the
host, and drops datagrams of other hosts. With IPv4 it is on the loopback interface, which needs no network.
"""

import select
import socket
import struct
from functools import lru_cache
from ipaddress import ip_address
from typing import Any

import can
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from hil.core.clock import NS_PER_S
from hil.support.emulated_can_mark import MULTICAST_PORT

_LARGEST = 4096
_SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("@ll")
_STAMP_BYTES = socket.CMSG_SPACE(_STAMP.size)
_MOST_STRANGERS = 64
"""Most datagrams of other hosts that one call to receive drops."""
_LOOPBACK = "127.0.0.1"


def is_of_this_host(sender: tuple[Any, ...]) -> bool:
    """Whether a sender, as `recvfrom` gives it, is this host: then a route to it starts there."""
    address = sender[0]
    if _is_loopback(address):
        return True
    with socket.socket(_family(address), socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(sender)
        except OSError:
            return False
        return bool(probe.getsockname()[0] == address)


@lru_cache(maxsize=64)
def _is_loopback(address: str) -> bool:
    """Whether an address is loopback; cached, because it is called for every frame, and senders are few."""
    return ip_address(address).is_loopback


class HostMulticastBus(can.BusABC):
    """A python-can bus on a multicast group of this host.

    Args:
        channel: IPv4 or IPv6 multicast group.
        port: UDP port of the bus.
        fd: True if CAN FD frames are taken.
        kwargs: further arguments of `can.BusABC`. A `hop_limit` changes nothing: it is 0.

    Raises:
        can.CanInitializationError: the group cannot be joined at this port.
    """

    def __init__(self, channel: str, port: int = MULTICAST_PORT, fd: bool = True, **kwargs: Any) -> None:
        self._to = (channel, int(port))
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self.channel_info = f"udp_multicast {channel}, port {port}, of this host"
        self._is_shutdown = True  # nothing is to be shut down if the group cannot be joined
        self._socket = _joined(*self._to)
        self._is_shutdown = False
        super().__init__(channel, **kwargs)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """The next frame of this host, stamped by the kernel (s since 1970); None after the timeout."""
        for _ in range(_MOST_STRANGERS):
            try:
                if timeout != 0.0 and not select.select([self._socket], [], [], timeout)[0]:
                    return None, False
                data, stamped, _, sender = self._socket.recvmsg(_LARGEST, _STAMP_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return None, False
            except (OSError, ValueError) as error:
                raise can.CanOperationError(f"nothing can be received: {error}") from error
            if is_of_this_host(sender):
                return self._frame(data, stamped), False
            timeout = 0.0
        return None, False

    def _frame(self, data: bytes, stamped: list[tuple[int, int, bytes]]) -> can.Message | None:
        seconds, nanoseconds = _STAMP.unpack(stamped[0][2])
        stamp = {"timestamp": seconds + nanoseconds / NS_PER_S}
        try:
            message = unpack_message(data, replace=stamp, check=True)
        except Exception as error:  # whatever msgpack and python-can say of bytes that are no frame
            raise can.CanOperationError(f"a datagram that is no CAN frame: {error}") from error
        return None if message.is_fd and self._can_protocol is not can.CanProtocol.CAN_FD else message

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to all on the bus, this one included; raises `can.CanOperationError`."""
        try:
            self._socket.sendto(pack_message(msg), self._to)
        except OSError as error:
            raise can.CanOperationError(f"nothing can be sent: {error}") from error

    def fileno(self) -> int:
        """Descriptor of the socket; -1 once it is closed."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Leave the bus. Idempotent."""
        super().shutdown()
        self._socket.close()


def _family(address: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def _joined(group: str, port: int) -> socket.socket:
    """A socket that receives a group at a port; for IPv6 on the interface of the route to the group."""
    opened = socket.socket(_family(group), socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        opened.bind((group, port))
        whole = socket.inet_pton(opened.family, group)
        if opened.family == socket.AF_INET6:
            opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, 0)
            opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, whole + bytes(4))
        else:
            loopback = socket.inet_aton(_LOOPBACK)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, whole + loopback)
    except (OSError, OverflowError) as error:
        opened.close()
        raise can.CanInitializationError(f"{group} cannot be joined at port {port}: {error}") from error
    return opened
