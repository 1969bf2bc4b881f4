"""Serves the daemon's socket: one JSON object a packet, from programs of the same user and of root.

Its name is in Linux' abstract space and names the fan. So it belongs to one process at a time, of
any user; it vanishes with that process; and it does not vanish with a folder, as a socket file in
`/run/user` does when its user logs out. It is visible where the CAN interface is: both belong to a network
namespace. Each end takes the other's user from the kernel. A daemon answers its own user and root, and
refuses others with the reason; a program sends requests to a daemon of its own user, one of root to any.

Asked `{"do": "status"}`, `{"do": "set", "quantity": q, "value": v}` or `{"do": "off", "confirmed_by": why}`
a daemon answers with its status, or with `{"error": {message, expected, remedy, exit_code}}`.
"""

import contextlib
import hashlib
import json
import os
import selectors
import socket
import struct
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from hil.core.errors import DeviceError, HilError, UsageError, reason_of
from hil.fan_daemon.spec import Spec
from hil.support.emulated_can_mark import abstract_names

MOST_BYTES = 8192
HOW_TO_ASK = 'send one JSON object a packet; docs/adhesion.md, "The socket", shows each'
IDLE_S = 30.0
"""A daemon without a running fan ends after so long without a client, unless it is a service."""
_MOST_CLIENTS = 32
_MOST_AT_ONCE = 16
_PEER = struct.Struct("3i")
_LONGEST_BUS, _BUS_KEPT = 70, 50
"""Bytes of a bus in a socket name, of which Linux has 107; of a longer bus so many, and a hash."""
_PREFIX = "hil-adhesion "
_MOST_TEXT = 1000


class Peer(NamedTuple):
    """The program at the other end of a connection: its process and user id."""

    pid: int
    uid: int

    def __str__(self) -> str:
        return f"process {self.pid} of user {self.uid}"


Answer = Callable[[Mapping[str, Any], Peer], Mapping[str, Any]]
"""Answers a (request, client); raises `HilError` to refuse it."""
Left = Callable[[int], None]
"""Takes the process id of a client that has hung up; the kernel hangs up at once for one that dies."""


def address(spec: Spec) -> str:
    """Address of the socket of a fan's daemon."""
    return f"\0{_PREFIX}{socket_name(spec)}"


def socket_name(spec: Spec) -> str:
    """The name of a fan in `running_daemons`; no two fans have the same."""
    return f"{_shortened(spec.bus)}, controller {spec.controller_id}"


def running_daemons() -> list[str]:
    """Names of all fans and propellers that have a daemon on this machine."""
    return abstract_names(_PREFIX)


def is_on(name: str, bus: str) -> bool:
    """Whether the fan or propeller with this name of `running_daemons` is on a bus."""
    return name.rpartition(", controller ")[0] == _shortened(bus)


def _shortened(bus: str) -> str:
    data = bus.encode()
    if len(data) <= _LONGEST_BUS:
        return bus
    return f"{data[:_BUS_KEPT].decode(errors='ignore')}...{hashlib.sha256(data).hexdigest()[:12]}"


def peer(connection: socket.socket) -> Peer:
    """Process and user id of the other end, by the kernel."""
    pid, uid, _ = _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
    return Peer(pid, uid)


def may_ask(uid: int, owner: int) -> bool:
    """Whether the user `uid` may send requests to a daemon of `owner`: only the same user and root may."""
    return uid in (0, owner)


def user(uid: int) -> str:
    """A user in messages: by number, as looking up a name may take too long for a daemon."""
    return "root" if uid == 0 else f"user {uid}"


def of_another(spec: Spec, owner: str, asker: str) -> DeviceError:
    """The refusal by another user's daemon.

    Args:
        spec: the fan.
        owner: the user that the daemon runs as.
        asker: the user that the program runs as.
    """
    return DeviceError(
        spec.device,
        f"{spec.whose} daemon belongs to {owner}, and this program to {asker}",
        port=spec.name,
        expected=f"a daemon of {asker}, or a program of root",
        remedy=f"run this as {owner}"
        + ("" if owner == "root" else ", or as root")
        + f"; a daemon that is no service ends {IDLE_S:g} s after the last program has left a motor at rest",
    )


class TakenError(DeviceError):
    """The fan has a daemon already."""


class Server:
    """The daemon's socket; raises `TakenError` when the fan has a daemon already.

    Args:
        spec: the fan.
        left: called with the process id of each client that has hung up.
    """

    def __init__(self, spec: Spec, left: Left = lambda pid: None) -> None:
        self._spec, self._left = spec, left
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._listener.bind(address(spec))
        except OSError as error:
            self._listener.close()
            raise TakenError(
                spec.device,
                f"it has a daemon already ({reason_of(error)})",
                port=spec.name,
                expected="one daemon of a fan",
                remedy="`hil adhesion status` names its process",
            ) from None
        self._listener.listen(_MOST_CLIENTS)
        self._listener.setblocking(False)
        self._ready = selectors.DefaultSelector()
        self._ready.register(self._listener, selectors.EVENT_READ)
        self.clients = 0

    def serve(self, timeout_s: float, answer: Answer) -> None:
        """Wait up to `timeout_s` for requests, and answer those that have arrived."""
        for key, _ in self._ready.select(timeout_s)[:_MOST_AT_ONCE]:
            if key.fileobj is self._listener:
                self._accept()
            else:
                assert isinstance(key.fileobj, socket.socket)
                self._answer(key.fileobj, answer)

    def close(self) -> None:
        """Hang up on all clients and free the name. Idempotent."""
        for key in list(self._ready.get_map().values()):
            self._ready.unregister(key.fileobj)
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.close()
        self.clients = 0

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._listener.accept()
            connection.setblocking(False)
            refused = self._refused(peer(connection).uid)
            if refused is not None:
                _turn_away(connection, refused)
                return
            self._ready.register(connection, selectors.EVENT_READ)
            self.clients += 1

    def _refused(self, uid: int) -> DeviceError | None:
        """Why a program of a user is refused; None where it is not."""
        spec = self._spec
        if not may_ask(uid, os.getuid()):
            return of_another(spec, user(os.getuid()), user(uid))
        if self.clients >= _MOST_CLIENTS:
            return DeviceError(
                spec.device,
                f"{spec.whose} daemon talks to {self.clients} programs already",
                port=spec.name,
                expected=f"at most {_MOST_CLIENTS}",
                remedy="end programs that talk to it and try again",
            )
        return None

    def _answer(self, connection: socket.socket, answer: Answer) -> None:
        """Answer one packet; a client that hangs up, or does not read, is disconnected."""
        try:
            packet = connection.recv(MOST_BYTES)
            if not packet:
                raise ConnectionResetError
            connection.send(_answered(packet, peer(connection), answer))
        except OSError:
            pid = peer(connection).pid
            self._ready.unregister(connection)
            connection.close()
            self.clients -= 1
            self._left(pid)


def _turn_away(connection: socket.socket, why: DeviceError) -> None:
    """Refuse and disconnect; the request is read first, or the kernel would discard the answer."""
    with connection:
        with contextlib.suppress(OSError):
            connection.recv(MOST_BYTES)
        with contextlib.suppress(OSError):
            connection.send(json.dumps({"error": _described(why)}).encode())


def _answered(packet: bytes, peer: Peer, answer: Answer) -> bytes:
    try:
        asked = json.loads(packet)
        if not isinstance(asked, dict):
            raise UsageError(
                "a request to the daemon that is no object", expected='{"do": "status"}', remedy=HOW_TO_ASK
            )
        reported = answer(asked, peer)
    except HilError as error:
        reported = {"error": _described(error)}
    except (ValueError, RecursionError):
        no_json = UsageError(
            "a request to the daemon that is no JSON", expected='{"do": "status"}', remedy=HOW_TO_ASK
        )
        reported = {"error": _described(no_json)}
    return json.dumps(reported).encode()[:MOST_BYTES]


def _described(error: HilError) -> dict[str, object]:
    return {
        "message": error.message[:_MOST_TEXT],
        "expected": error.expected,
        "remedy": error.remedy,
        "exit_code": error.exit_code,
    }
