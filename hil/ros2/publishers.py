"""Describes the publishers of a topic by DDS: their programs, and how long DDS lists one that was killed."""

import socket
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant
from cyclonedds.qos import Policy, Qos

from hil.core.clock import NS_PER_S, seconds

_MOST = 10_000
"""Most participants that are examined."""
_LONGEST_NS = 10**6 * NS_PER_S
"""Longest lease; a longer one counts as none."""
_PROCESS, _HOST = ("fastdds.physical_data.process", "__Pid"), ("fastdds.physical_data.host", "__Hostname")
"""Names of these properties in Fast DDS and Cyclone DDS."""


@dataclass(frozen=True)
class Publisher:
    """One writer of a topic.

    Attributes:
        handle: DDS handle, which its messages carry.
        kind: type of its messages.
        program: its process, else its identifier on DDS, in words.
        lease_s: time for which DDS lists it after it was killed; None if unknown.
    """

    handle: int
    kind: str
    program: str
    lease_s: float | None

    def __str__(self) -> str:
        return f"{self.program} ({self.kind.replace('/msg/', '/')})"


def handles_of(entity: Any) -> list[int]:
    """Handles of the writers that match a reader of Cyclone DDS, as their messages carry them."""
    return [handle & (1 << 64) - 1 for handle in matched(entity.get_matched_publications)]


def matched(handles: Callable[[], list[int]]) -> list[int]:
    """Handles from a call of Cyclone DDS's Python binding.

    The binding asks for their number first, and then for the handles. It raises an `IndexError` if there are
    more by then.
    """
    while True:
        try:
            return handles()
        except IndexError:
            continue


def publishers_of(participant: Any, entities: Mapping[str, Any]) -> Iterator[Publisher]:
    """The writers that match readers of Cyclone DDS now.

    Args:
        participant: participant of the readers.
        entities: readers, by the type of their messages.
    """
    seen = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant).read(N=_MOST)
    programs = {one.key: one.qos for one in seen}
    for kind, entity in entities.items():
        for handle in handles_of(entity):
            writer = entity.get_matched_publication_data(handle)
            if writer is not None:  # else it has left meanwhile
                quality = programs.get(writer.participant_key, Qos())
                yield Publisher(handle, kind, _program(quality) or f"GID {writer.key}", _lease_s(quality))


def _program(quality: Qos) -> str:
    """Process, and its computer unless it is this one; empty where DDS names none."""
    properties = {policy.key: policy.value for policy in quality if isinstance(policy, Policy.Property)}
    process = next((properties[name] for name in _PROCESS if properties.get(name)), "")
    host = next((properties[name].partition(":")[0] for name in _HOST if properties.get(name)), "")
    elsewhere = f" of {host}" if host not in ("", socket.gethostname()) else ""
    return f"process {process}{elsewhere}" if process else ""


def _lease_s(quality: Qos) -> float | None:
    lease = quality[Policy.Liveliness.Automatic]
    return seconds(lease.lease_duration) if lease and lease.lease_duration < _LONGEST_NS else None
