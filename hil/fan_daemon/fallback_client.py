"""A bench's client of the fan daemon, which commands the fan itself while the daemon fails.

The connection to the daemon is checked forty times a second. When the daemon hangs up, is silent or no
longer reaches the bus, the bench sends the same set-point itself, at once; it starts a new daemon, and
steps back when that one has taken over. Where the new daemon belongs to another user and refuses requests,
the bench goes on by itself. If the fan was emulated and its emulator has ended, nothing is done.
"""

import logging
import threading
from collections.abc import Callable

from hil.core.clock import NS_PER_S, Clock, nanoseconds
from hil.core.errors import DeviceError, HilError
from hil.fan_daemon.bus_cycle import BusCycle, open_bus
from hil.fan_daemon.client import (
    Connection,
    DaemonLaunch,
    Request,
    Status,
    ask,
    connect,
    find_or_start,
    of_whom,
    off_request,
    set_request,
    understood,
)
from hil.fan_daemon.commander import MotorCommander
from hil.fan_daemon.fan_control import FanControl, SetPoint, check_point
from hil.fan_daemon.spec import Spec
from hil.support.emulated_can_mark import Emulation

_LOG = logging.getLogger(__name__)

_LOOK_NS = nanoseconds(0.025)
_PATIENCE = 0.25
"""Share of the controller's timeout after which a daemon that is silent counts as dead."""
_AGAIN_NS = nanoseconds(2.0)
_STANDBY_NS = nanoseconds(0.2)
_LIKE = 0.02
"""Share of the highest set-point by which a new daemon may differ from the bench that steps back."""
_HAND_OVER_S = 10.0
_HEARD_BY_NS = nanoseconds(1.5)
"""A refused request is repeated for so long: a new daemon may not have a report of its fan yet."""
_STATUS: Request = {"do": "status"}


class FailoverClient(MotorCommander):
    """Commands a fan through its daemon, with the bench as a fallback.

    Args:
        spec: the fan.
        clock: the bench clock; real time.
        say: function that logs a line of text when the bench begins or stops commanding the fan instead of
            the daemon.
    """

    def __init__(self, spec: Spec, clock: Clock, *, say: Callable[[str], None] = _LOG.warning) -> None:
        self._spec, self._clock, self._say = spec, clock, say
        self._lock = threading.Lock()
        self._patience_ns = nanoseconds(_PATIENCE * spec.timeout_s)
        self._end: Callable[[], None] | None = None
        self._closed = True
        self._forget()

    def _forget(self) -> None:
        self._emulation = Emulation(self._spec.bus)
        self._link: Connection | None = None
        self._starting: DaemonLaunch | None = None
        self._status: Status = {}
        self._wish: Request | None = None
        self._refused: HilError | None = None
        self._in_for = self._shut_out = self._trouble = ""
        self._wish_until_ns = self._next_beat_ns = self._next_try_ns = 0
        self._cycle = BusCycle(self._spec, FanControl(self._spec, adopts=False), _LOG.info)

    def open(self) -> None:
        """Find the daemon of the fan, or start one, and check it from now on.

        Raises:
            DeviceError: none can be started, or the bus cannot be opened.
        """
        self.close()
        self._forget()
        bus = open_bus(self._spec)
        self._cycle = BusCycle(self._spec, FanControl(self._spec, adopts=False), _LOG.info, bus)
        try:
            link = find_or_start(self._spec)
            self._status = ask(link, _STATUS, self._spec)
        except DeviceError:
            self._cycle.close()
            raise
        if other := of_whom(self._status):
            self._say(f"{self._spec.whose} daemon is one{other}, process {self._status['pid']}")
        now_ns = self._clock.now_ns()
        self._link, self._closed = Connection(link, now_ns), False
        self._end = self._clock.schedule(self._task, now_ns)

    def set(self, point: SetPoint) -> None:
        """Request another set-point from the daemon; `trouble` reports a refusal. Raises `UsageError`."""
        check_point(self._spec, point)
        self._ask_for(set_request(point))

    def end(self, confirmed_by: str) -> None:
        """Request from the daemon that the fan comes to rest."""
        self._ask_for(off_request(confirmed_by))

    def _ask_for(self, wish: Request) -> None:
        with self._lock:
            now_ns = self._clock.now_ns()
            self._wish, self._refused = wish, None
            self._wish_until_ns = now_ns + _HEARD_BY_NS
            if self._in_for:
                self._obey(wish, now_ns)

    def status(self) -> Status:
        """The daemon's latest status, or the bench's own while it commands the fan."""
        with self._lock:
            return self._cycle.status(self._clock.now_ns()) if self._in_for else self._status

    def trouble(self) -> str:
        """The missing daemon, a refused request, or the fault of the bus, as of the last check."""
        return self._trouble

    def close(self) -> None:
        """Leave the fan to the daemon; a bench that commands the fan waits for a new daemon first."""
        if self._closed or self._end is None:
            return
        give_up_ns = self._clock.now_ns() + nanoseconds(_HAND_OVER_S)
        while self._stands_in() and not self._shut_out and self._clock.now_ns() < give_up_ns:
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)
        if self._stands_in():
            left = "has no daemon: it stops"
            if self._shut_out:
                left = "is left to a daemon that this program cannot ask: look with `hil adhesion status`"
            self._say(f"the bench ends and {self._spec.noun} {left}. Secure the robot")
        self._end()
        with self._lock:
            self._closed = True
            if self._link is not None:
                self._link.close()
            self._cycle.close()

    def _stands_in(self) -> bool:
        with self._lock:
            return bool(self._in_for)

    def _task(self, t_ns: int) -> int:
        with self._lock:
            if not self._closed:
                try:
                    self._look(t_ns)
                except Exception:
                    _LOG.exception("checking the fan's daemon went wrong")
        return t_ns + _LOOK_NS

    def _look(self, t_ns: int) -> None:
        """Read the daemon's answer, take over from it or hand back, send the next request."""
        self._hear(t_ns)
        why = self._amiss(t_ns)
        if why and self._emulation.is_over():
            self._let_it_go()
            return
        if why and not self._in_for:
            self._stand_in(t_ns, why)
        elif not why and self._in_for and self._link is not None:
            if self._has_taken_over():
                self._step_back()
            elif t_ns - self._link.since_ns > _AGAIN_NS:
                self._link.since_ns, self._wish = t_ns, self._our_wish()
        if t_ns >= self._next_beat_ns:
            self._next_beat_ns = t_ns + nanoseconds(self._spec.period_s)
            self._cycle.step(t_ns)
        if self._link is None:
            self._look_for_another(t_ns)
        else:
            self._ask(self._link)
        if self._in_for:
            reported = (self._in_for, self._shut_out, self._cycle.bus_error)
            self._trouble = "; ".join(text for text in reported if text)
        else:
            status = self._status
            amiss = self._refused or self._shut_out or status.get("bus_error") or status.get("sag")
            self._trouble = str(amiss or "")

    def _amiss(self, t_ns: int) -> str:
        """The daemon's fault in words; empty for none."""
        if self._link is None:
            return f"{self._spec.whose} daemon has ended"
        if t_ns - self._link.answered_ns > self._patience_ns:
            return f"{self._spec.whose} daemon does not answer"
        age_s = self._status.get("sent_age_s")
        if self._status["state"] != "idle" and (age_s is None or age_s * NS_PER_S > self._patience_ns):
            return f"{self._spec.whose} daemon does not reach the bus: " + str(self._status["bus_error"])
        return ""

    def _hear(self, t_ns: int) -> None:
        """Process the daemon's answer, if it has arrived."""
        if (link := self._link) is None:
            return
        try:
            answer = link.answer(t_ns)
        except OSError:
            self._lose(link, t_ns)
            return
        if answer is None:
            return
        asked, packet = answer
        try:
            self._status = {**understood(packet, self._spec), "uid": link.uid}
        except DeviceError as error:
            if t_ns < self._wish_until_ns:
                return
            self._refuse(error)
        except HilError as error:
            self._refuse(error)
        if asked is self._wish:
            self._wish = None

    def _refuse(self, error: HilError) -> None:
        self._refused = error
        self._say(str(error))

    def _ask(self, link: Connection) -> None:
        try:
            link.ask(self._wish or _STATUS)
        except OSError:
            self._lose(link, self._clock.now_ns())

    def _lose(self, link: Connection, t_ns: int) -> None:
        """The daemon has hung up; its standby has a moment before another daemon is started."""
        link.close()
        self._link = None
        self._next_try_ns = max(self._next_try_ns, t_ns + _STANDBY_NS)

    def _stand_in(self, t_ns: int, why: str) -> None:
        """Send the daemon's last set-point, from this check on."""
        sent, target = self._status.get("sent"), self._status.get("target")
        if sent is None or target is None:
            return
        self._in_for = f"{why}: the bench commands {self._spec.noun} itself"
        self._say(self._in_for)
        self._next_beat_ns = t_ns
        self._cycle.control = FanControl(self._spec, adopts=False)
        self._cycle.control.resume(t_ns, SetPoint(*sent), SetPoint(*target))
        if self._status["state"] == "ending":
            self._cycle.control.end(t_ns)
        if self._wish is not None:
            self._obey(self._wish, t_ns)

    def _let_it_go(self) -> None:
        """Stop: an emulated fan ends with its emulator, so nothing is left to command."""
        if self._link is not None:
            self._link.close()
        trouble = f"{self._spec.bus} was emulated and is gone: {self._spec.noun} has no daemon"
        if self._trouble != trouble:
            self._say(trouble)
        self._link, self._status, self._in_for, self._shut_out = None, {}, "", ""
        self._trouble = trouble
        self._cycle.control = FanControl(self._spec, adopts=False)

    def _obey(self, wish: Request, t_ns: int) -> None:
        """Carry out a request to the daemon in its place."""
        if wish["do"] == "off":
            self._cycle.control.end(t_ns)
        else:
            self._cycle.control.set_target(t_ns, SetPoint(str(wish["quantity"]), float(str(wish["value"]))))

    def _has_taken_over(self) -> bool:
        """Whether the daemon sends what the bench sends."""
        sent, ours = self._status.get("sent"), self._cycle.control.sent
        if sent is None or ours is None:
            return sent is None and ours is None
        quantity, value = sent
        return bool(
            quantity == ours.quantity and abs(value - ours.value) <= _LIKE * self._spec.highest[quantity]
        )

    def _step_back(self) -> None:
        self._wish = self._our_wish()
        self._cycle.control = FanControl(self._spec, adopts=False)
        self._in_for = ""
        self._say(f"{self._spec.whose} daemon has taken over again")

    def _look_for_another(self, t_ns: int) -> None:
        """Find the standby, or a daemon that another program has started; or start one."""
        if self._shut_out and t_ns < self._next_try_ns:
            return
        try:
            found = connect(self._spec)
        except DeviceError as error:
            self._stay_out(t_ns, error)
            return
        self._shut_out = ""
        if found is not None:
            self._link, self._status = Connection(found, t_ns), {"state": "idle"}
            if self._starting is not None:
                self._starting.leave()
                self._starting = None
        elif self._starting is not None:
            said = self._starting.first_line(0.0)
            if said is not None:
                self._starting = None
                if "pid" not in said:
                    self._say(f"{self._spec.device}: a new daemon did not start: {said.get('error')}")
        elif t_ns >= self._next_try_ns:
            self._starting = DaemonLaunch(self._spec, emulated=self._emulation.known)
            self._next_try_ns = t_ns + _AGAIN_NS

    def _stay_out(self, t_ns: int, why: DeviceError) -> None:
        """A daemon refuses this user: report it once, and try again now and then."""
        self._next_try_ns = t_ns + _AGAIN_NS
        if self._shut_out != why.message:
            self._shut_out = why.message
            self._say(str(why))
        if self._starting is not None and self._starting.first_line(0.0) is not None:
            self._starting = None

    def _our_wish(self) -> Request | None:
        """The request to send to a new daemon, as it takes over only the set-point that is sent."""
        control = self._cycle.control
        if control.ending:
            return off_request("asked for before the daemon was started anew")
        return None if control.aim is None else set_request(control.aim)
