"""`/diagnostics` of a bench: its events, what stopped it, and how it left the robot."""

from collections.abc import Mapping, Sequence
from typing import Any

from hil.core.signals import Event
from hil.recording.rosbags_adapter import MessageMaker, to_cdr

TOPIC, TYPE = "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_OK, _WARN, _ERROR = 0, 1, 2
_LEVELS = {"debug": _OK, "info": _OK, "error": _ERROR, "fatal": _ERROR}
_HELD_LEVELS = {"HELD": _OK, "not needed": _OK}


class Diagnostics:
    """Makes the messages of one bench.

    Args:
        name: name of the bench; goes into the messages as the hardware.
        ros: maker of messages with stamps.
    """

    def __init__(self, name: str, ros: MessageMaker) -> None:
        self._name, self._ros = name, ros

    def events(self, t_ns: int, events: Sequence[Event]) -> bytes:
        """Message with the events of one cycle; each status is named after the source of its event.

        Args:
            t_ns: bench time.
            events: events of the cycle.
        """
        statuses = [self._status(_LEVELS.get(e.level, _WARN), e.source, e.message, {}) for e in events]
        return self._array(t_ns, statuses)

    def held(self, t_ns: int, held: Mapping[str, object]) -> bytes:
        """Message on how the robot was left.

        Args:
            t_ns: bench time.
            held: data of the note `hil.core.interfaces.HELD_NOTE`: state, `moved_m`, why.
        """
        state = str(held["state"])
        values = {} if held["moved_m"] is None else {"moved_m": str(held["moved_m"])}
        text = f"{state}: {held['why']}"
        return self._array(t_ns, [self._status(_HELD_LEVELS.get(state, _ERROR), "held", text, values)])

    def _array(self, t_ns: int, status: Sequence[Any]) -> bytes:
        header = self._ros.header(t_ns, "")
        return to_cdr(self._ros.message(TYPE, header=header, status=list(status)))

    def _status(self, level: int, source: str, message: str, values: Mapping[str, str]) -> Any:
        pairs = [
            self._ros.message("diagnostic_msgs/msg/KeyValue", key=key, value=value)
            for key, value in values.items()
        ]
        return self._ros.message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=f"hil: {source}",
            message=message,
            hardware_id=self._name,
            values=pairs,
        )
