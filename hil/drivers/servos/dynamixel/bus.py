"""Requests on a DYNAMIXEL bus: single ones through the SDK, group ones through our own packets."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS, PacketHandler

from hil.core.clock import NS_PER_S, Clock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.servos.dynamixel import packets
from hil.drivers.servos.dynamixel.packets import ALERT, ERROR_NUMBER, ERROR_TEXT, Answer, GroupRead
from hil.drivers.servos.dynamixel.sdk_port import PortLost, ServoPort

T = TypeVar("T")

_ATTEMPTS = 3
_OLDEST_NS = 50_000_000
_LONGEST_ROUND_TRIP_NS = 100_000_000
_RESULTS = {COMM_RX_TIMEOUT: Status.TIMEOUT, COMM_RX_CORRUPT: Status.CRC}


class Exchange(NamedTuple):
    """Bytes of one group read, and its times.

    Attributes:
        sent_ns: time at which the request was handed to the port.
        received_ns: time at which the answer was complete, or timed out.
        taken_ns: time at which the servos sampled the values.
    """

    data: bytes
    sent_ns: int
    received_ns: int
    taken_ns: int


class _Asked(NamedTuple):
    """A group read whose answer has not been fetched."""

    group: GroupRead
    sent_ns: int
    deadline_ns: int


class Bus:
    """An open port with the instructions of Protocol 2.0.

    The bus is half-duplex: while the answer to a request sent ahead is under way, other packets wait.

    Args:
        port: port, opened by the caller.
        clock: the bench clock.
        device: name in errors.
    """

    def __init__(self, port: ServoPort, clock: Clock, device: str) -> None:
        self.port, self._clock, self.device = port, clock, device
        self._sdk = PacketHandler(2.0)
        self.traffic_ns = clock.now_ns()
        self._asked: _Asked | None = None
        self._ahead: Exchange | None = None
        self._round_trip_ns = _LONGEST_ROUND_TRIP_NS

    def close(self) -> None:
        """Close the port; never raises."""
        self.port.closePort()

    def set_baud(self, baud: int) -> None:
        """Change the baud rate of the port; raises `DeviceError` when the port is lost."""
        try:
            self.port.setBaudRate(baud)
        except PortLost as error:
            raise DeviceError(
                self.device,
                f"the port is gone ({error})",
                port=self.port.port_name,
                expected="an adapter that stays plugged in",
                remedy="check the USB cable, then repeat",
            ) from None

    def ping(self, servo_id: int) -> Answer:
        """Ping a servo, one attempt; the data of the answer are its model number."""
        model, result, error = self._call_sdk(lambda: self._sdk.ping(self.port, servo_id), (0, None, 0))
        return self._answer(result, error, bytes((model & 0xFF, model >> 8 & 0xFF)))

    def read(self, servo_id: int, address: int, length: int, attempts: int = _ATTEMPTS) -> Answer:
        """Read registers of one servo; if all attempts fail, the answer has the last failure."""
        answer = packets.NO_ANSWER
        nothing: list[int] = []
        for _ in range(attempts):
            data, result, error = self._call_sdk(
                lambda: self._sdk.readTxRx(self.port, servo_id, address, length), (nothing, None, 0)
            )
            answer = self._answer(result, error, bytes(data))
            if answer.status is Status.OK and len(answer.data) != length:
                answer = Answer(Status.PROTOCOL, error)
            if answer.status is Status.OK:
                break
        return answer

    def write(self, servo_id: int, address: int, data: bytes, attempts: int = _ATTEMPTS) -> Answer:
        """Write registers of one servo and take its acknowledgement."""
        answer = packets.NO_ANSWER
        for _ in range(attempts):
            result, error = self._call_sdk(
                lambda: self._sdk.writeTxRx(self.port, servo_id, address, len(data), list(data)), (None, 0)
            )
            answer = self._answer(result, error, b"")
            if answer.status in (Status.OK, Status.PROTOCOL):
                break
        return answer

    def send(self, packet: bytes) -> bool:
        """Send a packet without an answer; False when the port is lost."""
        self._settle()
        self.traffic_ns = self._clock.now_ns()
        try:
            self.port.writePort(packet)
        except PortLost:
            return False
        return True

    def exchange(self, group: GroupRead, timeout_s: float) -> Exchange:
        """One group read within `timeout_s`; its bytes may be missing or incomplete."""
        self._settle()
        return self._fetch(self._ask(group, timeout_s))

    def ask(self, group: GroupRead, timeout_s: float, after: bytes = b"") -> None:
        """Send the request of a group read whose answer `answered` will fetch.

        Args:
            group: the group read.
            timeout_s: longest time of the answer.
            after: a packet without an answer, sent before the request in the same transfer.
        """
        self._settle()
        self._ahead, self._asked = None, self._ask(group, timeout_s, after)

    def asked(self) -> bool:
        """Whether an answer can be fetched; a request of more than 50 ms ago is dropped."""
        asked = self._ahead if self._asked is None else self._asked
        if asked is None:
            return False
        if self._clock.now_ns() - asked.sent_ns > _OLDEST_NS:
            self._asked = self._ahead = None
            return False
        return True

    def answered(self, patience_ns: int) -> Exchange:
        """The answer to `ask`, waited for until its deadline and at least `patience_ns` from now.

        A busy host may run the caller only after the deadline; the answer may then arrive any moment.
        """
        if self._asked is not None:
            patient_ns = self._clock.now_ns() + patience_ns
            if patient_ns > self._asked.deadline_ns:
                self._asked = self._asked._replace(deadline_ns=patient_ns)
        self._settle()
        found, self._ahead = self._ahead, None
        assert found is not None
        return found

    def _settle(self) -> None:
        """Fetch the answer that is still under way, if any."""
        if self._asked is not None:
            asked, self._asked = self._asked, None
            self._ahead = self._fetch(asked)

    def _ask(self, group: GroupRead, timeout_s: float, after: bytes = b"") -> _Asked:
        sent_ns = self._clock.now_ns() + self.port.backlog_ns()
        if after:
            sent_ns += self.port.wire_ns(len(after))
        self.traffic_ns = sent_ns
        try:
            self.port.clearPort()
            self.port.writePort(after + group.request)
        except PortLost:
            pass  # the read of the answer reports it
        return _Asked(group, sent_ns, sent_ns + round(timeout_s * NS_PER_S))

    def _fetch(self, asked: _Asked) -> Exchange:
        clock, group = self._clock, asked.group
        data = b""
        try:
            data = self.port.receive(group.expected, (asked.deadline_ns - clock.now_ns()) / NS_PER_S)
            if not group.plausible(data):
                data = self._more(group, data, asked.deadline_ns)
        except PortLost:
            clock.sleep_until_ns(asked.deadline_ns)
        received_ns = clock.now_ns()
        taken_ns = self._taken_ns(asked, len(data), received_ns)
        return Exchange(data, asked.sent_ns, received_ns, taken_ns)

    def _taken_ns(self, asked: _Asked, count: int, received_ns: int) -> int:
        """When the servos received the request: after its time on the wire and half the round-trip latency.

        That latency (network, drivers) is the smallest seen: an answer may have waited to be fetched.
        """
        heard_ns = asked.sent_ns + self.port.wire_ns(len(asked.group.request))
        round_trip_ns, least_ns = received_ns - heard_ns - self.port.answer_ns(count), self._round_trip_ns
        if round_trip_ns < 0:
            round_trip_ns = 0
        if round_trip_ns >= least_ns:
            round_trip_ns = least_ns
        elif count == asked.group.expected:
            self._round_trip_ns = round_trip_ns
        return heard_ns + round_trip_ns // 2

    def _more(self, group: GroupRead, data: bytes, deadline_ns: int) -> bytes:
        """Go on receiving when noise, an echo or stuffing has made the answer longer."""
        while not group.complete(data):
            left_ns = deadline_ns - self._clock.now_ns()
            if left_ns <= 0:
                break
            data += self.port.receive(max(1, group.expected - len(data)), left_ns / NS_PER_S)
        return data

    def unasked(self) -> int:
        """How many bytes have arrived while no answer is awaited."""
        try:
            return 0 if self._asked is not None else self.port.waiting()
        except PortLost:
            return 0

    def gather(self, duration_s: float, limit: int) -> bytes:
        """Everything that arrives during `duration_s`."""
        try:
            return self.port.receive(limit, duration_s)
        except PortLost:
            return b""

    def demand(self, servo_id: int, address: int, data: bytes, what: str) -> None:
        """Write with acknowledgement; raises `DeviceError` that names the servo and what was written."""
        answer = self.write(servo_id, address, data)
        if answer.status is not Status.OK:
            raise self.failure(answer, f"servo {servo_id}: {what} cannot be written")

    def failure(self, answer: Answer, what: str) -> DeviceError:
        """The error for an answer that was not OK."""
        kind = DeviceTimeoutError if answer.status is Status.TIMEOUT else DeviceError
        number = answer.error & ERROR_NUMBER
        reason = f"the servo {ERROR_TEXT.get(number, f'reports error {number}')}" if number else ""
        return kind(
            self.device,
            f"{what} ({reason or answer.status.value})",
            port=self.port.port_name,
            expected=f"an acknowledgement at {self.port.baudrate} baud",
            remedy="check cable and power" if not number else "switch torque off or check the value",
        )

    def _call_sdk(self, call: Callable[[], T], lost: T) -> T:
        """A call into the SDK; a lost port becomes a failed result."""
        self._settle()
        self.traffic_ns = self._clock.now_ns()
        try:
            return call()
        except PortLost:
            self._clock.sleep_until_ns(self.traffic_ns + round(self.port.reply_s(16, 16) * NS_PER_S))
            return lost
        finally:
            self.port.is_using = False

    @staticmethod
    def _answer(result: int | None, error: int, data: bytes) -> Answer:
        if result != COMM_SUCCESS:
            return Answer(_RESULTS.get(result, Status.TIMEOUT) if result is not None else Status.TIMEOUT)
        if error & ERROR_NUMBER:
            return Answer(Status.PROTOCOL, error)
        return Answer(Status.OK, error & ALERT, data)
