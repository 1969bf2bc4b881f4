"""Serves the emulated devices in real time to any client; used by `hil emulate`.

The world follows the monotonic clock; a client's bytes are passed to their transport as soon as the kernel
reports them. One thread; it never sleeps beyond the next planned action.

After a lack of processor time, the process catches up in short pieces and handles received data between them.
In one piece, a controller would time out although its commands had long arrived, and release the robot.
Replies of a chip that is far behind are dropped: the client would take old values for present ones, and see
a jump of the robot as soon as the world has caught up.
"""

import os
import select
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Protocol

from hil.core.clock import NS_PER_S, Clock
from hil.fakes.world import Scheduled, World

_LONGEST_WAIT_S = 0.05
_PIECE_NS = 20_000_000
_BEHIND_NS = 50_000_000
"""A client has stopped waiting for a reply by then."""
_TOO_SHORT_TO_SLEEP_S = 80e-6
_WARM_UP_NS = 3_000_000


class Transport(Scheduled, Protocol):
    """Connection of an emulated device to the outside: PTY, socket or CAN interface.

    Attributes:
        behind: set by the server while the world is far behind its clock.
    """

    behind: bool = False

    @abstractmethod
    def filenos(self) -> list[int]:
        """File descriptors to watch for input."""

    @abstractmethod
    def on_readable(self, fd: int, t_ns: int) -> None:
        """Handle received data; the world has been advanced to `t_ns`."""

    @abstractmethod
    def endpoint(self) -> Mapping[str, object]:
        """Addresses with which a client reaches the device, for the JSON line of `hil emulate`."""

    @abstractmethod
    def close(self) -> None:
        """Close. Idempotent."""


class EmulationServer:
    """Runs a world and its transports until it is stopped.

    Args:
        world: world with the emulated devices.
        clock: clock that the world follows.
        transports: connections to the outside, by name.
        lifeline: file descriptor of a pipe; the server ends when the other end is closed.
        await_start: world time stands still until a byte arrives on the lifeline, because a robot without
            torque would slide down the wall while its bench loads.
    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        transports: Mapping[str, Transport],
        *,
        lifeline: int | None = None,
        await_start: bool = False,
    ) -> None:
        self.world, self.clock, self.transports = world, clock, dict(transports)
        self._lifeline = [] if lifeline is None else [lifeline]
        self._warm_up()
        self._start_ns = clock.now_ns() - world.now_ns
        self._waiting = await_start
        self._running = True
        for transport in self.transports.values():
            world.add(transport)

    def _warm_up(self) -> None:
        """Advance the first milliseconds before clients connect: compiling may take seconds."""
        self.world.advance_to(self.world.now_ns + _WARM_UP_NS)
        self.world.sync_plant()

    def endpoints(self) -> dict[str, Mapping[str, object]]:
        """Endpoint of every transport by name."""
        return {name: transport.endpoint() for name, transport in self.transports.items()}

    def stop(self) -> None:
        """Make `run` return soon; safe to call from a signal handler."""
        self._running = False

    def run(self, ready: Callable[[], None] | None = None) -> None:
        """Serve until `stop`; always closes the transports.

        Args:
            ready: called once, as soon as time advances and every device is served.
        """
        try:
            while self._running:
                self.step()
                if ready is not None and self._running and not self._waiting:
                    ready()
                    ready = None
        finally:
            self.close()

    def step(self) -> None:
        """Advance the world to now and serve what is readable, waiting at most 50 ms for it.

        Raises:
            HilError: code of another package has raised an error.
        """
        for error in self.world.failures.values():
            raise error
        caught_up = self._waiting or self._advance()
        owners = {fd: transport for transport in self.transports.values() for fd in transport.filenos()}
        wait_s = _LONGEST_WAIT_S
        if not self._waiting:
            wait_s = (self.world.next_due_ns() - self._now_ns()) / NS_PER_S
            if wait_s < _TOO_SHORT_TO_SLEEP_S or not caught_up:
                wait_s = 0.0
        watched = [*owners, *self._lifeline]
        readable, _, _ = select.select(watched, [], [], min(max(wait_s, 0.0), _LONGEST_WAIT_S))
        for fd in readable:
            if fd in self._lifeline:
                self._running = bool(os.read(fd, 1))
                self._begin()
                continue
            if not self._waiting:
                self._advance()
            owners[fd].on_readable(fd, self.world.now_ns)

    def _begin(self) -> None:
        if self._waiting:
            self._waiting, self._start_ns = False, self.clock.now_ns() - self.world.now_ns

    def close(self) -> None:
        """Close every transport."""
        for transport in self.transports.values():
            transport.close()

    def _now_ns(self) -> int:
        return self.clock.now_ns() - self._start_ns

    def _advance(self) -> bool:
        """Advance to now, or by the largest piece before data must be handled again.

        Returns:
            True if the world has reached now.
        """
        now_ns = self._now_ns()
        reached_ns = min(now_ns, self.world.now_ns + _PIECE_NS)
        behind = now_ns - reached_ns > _BEHIND_NS
        for transport in self.transports.values():
            transport.behind = behind
        self.world.advance_to(reached_ns)
        return reached_ns == now_ns
