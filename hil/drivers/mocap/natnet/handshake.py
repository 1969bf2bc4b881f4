"""Agrees with a NatNet server on bit stream and rigid body, and waits for its first frame."""

from collections.abc import Callable

from hil.config.mocap import MocapConfig
from hil.core.clock import Clock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.drivers.mocap.natnet.packets import ServerInfo
from hil.drivers.mocap.natnet.session import NewFrame, Session

_WAIT_NS = 1_000_000
_ASK_AGAIN_NS = 250_000_000
_OLDEST_VERSION = (3, 0)


class Handshake:
    """Server, bit stream, rigid body, first frame, in this order.

    Args:
        session: open ports to the server.
        config: the wanted version and rigid body.
        clock: the bench clock.
        name: device name in errors.
        silent: function that makes the error for a silent server.
    """

    def __init__(
        self,
        session: Session,
        config: MocapConfig,
        clock: Clock,
        name: str,
        silent: Callable[[str], DeviceTimeoutError],
    ) -> None:
        self._session, self._config, self._clock = session, config, clock
        self._name, self._silent = name, silent
        self._port = f"{config.server}:{config.command_port}"

    def run(self, deadline_ns: int) -> tuple[ServerInfo, NewFrame]:
        """The server's description and its first frame.

        Raises:
            DeviceTimeoutError: it does not answer, or sends no frames.
            DeviceError: its version cannot be used, or it has no such body.
        """
        session = self._session
        self._ask(session.connect, lambda _: session.server is not None, deadline_ns, "no server answers")
        assert session.server is not None
        self._settle_version(deadline_ns)
        self._ask(
            session.ask_models, lambda _: session.bodies is not None, deadline_ns, "no model definitions come"
        )
        self._check_body()
        frames = self._ask(session.connect, bool, deadline_ns, "the server sends no frames")
        return session.server, frames[0]

    def _settle_version(self, deadline_ns: int) -> None:
        session, wanted = self._session, self._config.natnet_version
        if wanted is not None and wanted != self._version():
            major, minor = (int(part) for part in wanted.split("."))
            limit_ns = min(deadline_ns, self._clock.now_ns() + 2 * _ASK_AGAIN_NS)
            try:
                self._ask(
                    lambda: session.ask_version((major, minor)),
                    lambda _: self._version() == wanted,
                    limit_ns,
                    "the version stays",
                )
            except DeviceTimeoutError:
                raise self._wrong_version(wanted, "leave mocap.natnet_version out") from None
        if session.version < _OLDEST_VERSION:
            raise self._wrong_version("3.0 or later", "update Motive")

    def _version(self) -> str:
        return "{}.{}".format(*self._session.version)

    def _wrong_version(self, expected: str, remedy: str) -> DeviceError:
        return DeviceError(
            self._name,
            f"the server speaks NatNet {self._version()}",
            port=self._port,
            expected=f"NatNet {expected}",
            remedy=remedy,
        )

    def _check_body(self) -> None:
        bodies = self._session.bodies or {}
        if self._session.body_id not in bodies:
            present = ", ".join(f"{name!r} (id {i})" for i, name in sorted(bodies.items()))
            raise DeviceError(
                self._name,
                f"there is no rigid body {self._config.body!r}",
                port=self._port,
                expected=f"one of {present}" if bodies else "a rigid body that streams; there is none",
                remedy="set mocap.body to its name or streaming id, and enable it in Motive",
            )

    def _ask(
        self,
        ask: Callable[[], None],
        answered: Callable[[list[NewFrame]], bool],
        deadline_ns: int,
        failure: str,
    ) -> list[NewFrame]:
        """Repeat a request until it is answered; returns the frames that came with the answer."""
        ask_ns = self._clock.now_ns()
        while (now_ns := self._clock.now_ns()) < deadline_ns:
            if now_ns >= ask_ns:
                ask()
                ask_ns = now_ns + _ASK_AGAIN_NS
            frames = list(self._session.frames())
            if answered(frames):
                return frames
            self._clock.sleep_until_ns(now_ns + _WAIT_NS)
        raise self._silent(failure)
