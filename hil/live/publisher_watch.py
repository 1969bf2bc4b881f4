"""Warns, while a session runs, of a publisher of commands that is missing, sends nothing, or is gone."""

from __future__ import annotations

import logging

from hil.core.clock import NS_PER_S
from hil.ros2.command_topic import CommandTopic
from hil.ros2.publishers import Publisher

LOG = logging.getLogger(__name__)
_PATIENCE_S = 5
_NONE = 0
"""Handle of no publisher."""


class PublisherWatch:
    """Warns once of each.

    Args:
        topic: from which the commands come.

    Attributes:
        lost: publishers that are gone.
    """

    def __init__(self, topic: CommandTopic) -> None:
        self._topic, self.lost = topic, 0
        self._known: dict[int, Publisher] = {}
        self._since_ns: dict[int, int] = {}
        self._warned: set[int] = set()

    def look(self, t_ns: int) -> None:
        """Look which publishers are there.

        Args:
            t_ns: now, bench clock; of every cycle.
        """
        found = self._topic.publishers()
        if found != self._known.keys():
            self._changed()
        silent = [handle for handle in found if self._topic.silent_s(handle) is None]
        if not found and not self._known and not self.lost:
            silent = [_NONE]
        for handle in silent:
            since_ns = self._since_ns.setdefault(handle, t_ns)
            if handle not in self._warned and t_ns - since_ns > _PATIENCE_S * NS_PER_S:
                self._warned.add(handle)
                why = self._topic.why_silent() if handle else self._topic.why_none()
                LOG.warning("no command within %d s: %s", _PATIENCE_S, why)

    def _changed(self) -> None:
        """Note which are there now, and warn of those that are gone."""
        now = {one.handle: one for one in self._topic.described()}
        for handle in self._known.keys() - now.keys():
            self.lost += 1
            silent_s = self._topic.silent_s(handle)
            last = "without a command" if silent_s is None else f"{silent_s:.1f} s after its last command"
            LOG.warning("%s: %s is gone, %s", self._topic.name, self._known[handle], last)
        self._known = now
