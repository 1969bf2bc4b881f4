"""Velocity commands from outside, one to a line: over loopback UDP or on standard input.

    v VX VY W     body velocity: m/s ahead, m/s to the left, rad/s counter-clockwise
    stop          at rest, at once

The loop polls for lines that have arrived; nothing here blocks and no thread is needed. To keep the robot
moving, a sender repeats its command before the dead-man timeout (`hil.live.velocity_reference`).

Any user of this host can send to a port of it, so a datagram has to begin with a token that only the
operator knows.
"""

import hmac
import logging
import math
import os
import secrets
import select
import socket
from abc import abstractmethod
from collections.abc import Mapping
from typing import Protocol

from hil.core.errors import UsageError

LOG = logging.getLogger(__name__)

LONGEST_LINE = 200
TOKEN_VARIABLE = "HIL_COMMAND_TOKEN"

_LEAST_TOKEN = 16
_DATAGRAMS_PER_CYCLE = 256
_LINES_PER_CYCLE = 64
_CHUNK = 4096
_REPORTED = 5


def parse_command(line: str) -> tuple[float, float, float]:
    """Body velocity (m/s, m/s, rad/s) of a line; `stop` is all zero.

    Raises:
        UsageError: anything else.
    """
    words = line.split()
    if words == ["stop"]:
        return (0.0, 0.0, 0.0)
    try:
        if words[:1] == ["v"]:
            x_m_s, y_m_s, omega_rad_s = map(float, words[1:])
            if all(map(math.isfinite, (x_m_s, y_m_s, omega_rad_s))):
                return (x_m_s, y_m_s, omega_rad_s)
    except ValueError:
        pass
    raise UsageError(
        f"velocity command {line[:LONGEST_LINE]!r}", expected="`v VX VY W` in m/s, m/s, rad/s, or `stop`"
    )


class CommandLines(Protocol):
    """Source of command lines."""

    where: str

    @abstractmethod
    def pending(self) -> list[str]:
        """Whole lines that have arrived since the last call, oldest first; never blocks."""

    @abstractmethod
    def counts(self) -> Mapping[str, int]:
        """Numbers of discarded messages or lines, by reason, for the summary."""

    @abstractmethod
    def close(self) -> None:
        """Close the source. Idempotent."""


def command_token() -> str:
    """The token of the environment variable `HIL_COMMAND_TOKEN`, else a new one.

    Raises:
        UsageError: the variable holds one that is short or not one printable word.
    """
    given = os.environ.get(TOKEN_VARIABLE)
    if given is None:
        return secrets.token_hex(_LEAST_TOKEN)
    if len(given) < _LEAST_TOKEN or not given.isascii() or not given.isprintable() or " " in given:
        raise UsageError(
            f"the token in {TOKEN_VARIABLE} cannot be used",
            expected=f"at least {_LEAST_TOKEN} ASCII characters without spaces",
            remedy="unset the variable, and a token is made and printed",
        )
    return given


class UdpLines(CommandLines):
    """Datagrams to a port of this host only; each holds the token and then one or more lines.

    Args:
        port: UDP port on 127.0.0.1; 0 takes a free one.
        token: text that every datagram begins with.

    Attributes:
        port: the port in use.
        strangers: datagrams without the token.
        dropped: lines dropped because too many arrived at once; the newest are kept.

    Raises:
        UsageError: the port is taken.
    """

    def __init__(self, port: int, token: str) -> None:
        self._token = token.encode("ascii")
        self.strangers = self.dropped = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise UsageError(
                f"velocity commands: UDP port {port} cannot be used ({error})", remedy="choose another port"
            ) from None
        self.port: int = self._socket.getsockname()[1]
        self.where = f"udp:{self.port}"

    def pending(self) -> list[str]:
        """Lines of the waiting datagrams, up to a limit; the rest stays for the next cycle."""
        lines: list[str] = []
        for _ in range(_DATAGRAMS_PER_CYCLE):
            try:
                data, sender = self._socket.recvfrom(_CHUNK)
            except OSError:
                break
            found = self._opened(data, sender)
            self.dropped += max(0, len(lines) + len(found) - _LINES_PER_CYCLE)
            lines = (lines + found)[-_LINES_PER_CYCLE:]
        return lines

    def _opened(self, data: bytes, sender: tuple[str, int]) -> list[str]:
        """Lines of a datagram; none where it does not begin with the token."""
        token, _, rest = data.partition(b" ")
        if hmac.compare_digest(token, self._token):
            return rest.decode("ascii", "replace").splitlines()
        self.strangers += 1
        if self.strangers <= _REPORTED:
            LOG.warning("a velocity command from %s:%d without the token was refused", *sender)
        return []

    def counts(self) -> Mapping[str, int]:
        """Datagrams without the token, and lines that were too many."""
        return {"without_token": self.strangers, "dropped": self.dropped}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StdinLines(CommandLines):
    """Lines from a file descriptor, by default standard input; its end counts as `stop`."""

    where = "stdin"

    def __init__(self, descriptor: int = 0) -> None:
        self._descriptor, self._rest, self._ended = descriptor, b"", False

    def pending(self) -> list[str]:
        """Complete lines; an incomplete one stays buffered until its end arrives."""
        if self._ended or not select.select([self._descriptor], [], [], 0.0)[0]:
            return []
        data = os.read(self._descriptor, _CHUNK)
        if not data:
            self._ended = True
            return ["stop"]
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST_LINE:]
        return [line.decode("ascii", "replace") for line in whole]

    def counts(self) -> Mapping[str, int]:
        """Nothing: every line is passed on."""
        return {}

    def close(self) -> None:
        """Do nothing: standard input stays open."""


def open_commands(spec: str) -> CommandLines | None:
    """Source of a `--command` option: `stdin`, `udp:PORT` or `none`.

    Raises:
        UsageError: anything else, or a port that is taken.
    """
    if spec == "none":
        return None
    if spec == "stdin":
        return StdinLines()
    kind, _, port = spec.partition(":")
    if kind == "udp" and port.isdecimal():
        token = command_token()
        lines = UdpLines(int(port), token)
        if TOKEN_VARIABLE not in os.environ:
            lines.where += f", token {token}"
        return lines
    raise UsageError(f"--command {spec}", expected="stdin, udp:PORT or none")
