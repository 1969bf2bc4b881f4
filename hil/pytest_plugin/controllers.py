"""The marker `controller`: selects the controller for every trajectory of a test's bench."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from hil.core.errors import UsageError
from hil.core.known_names import HIGHEST_DOMAIN, LAWS, ROS2
from hil.procedure.bench_source import BenchSource
from hil.user_code.roles import CONTROLLER

if TYPE_CHECKING:
    from hil.config.ros2 import Ros2Config
    from hil.ros2.network import Network
    from hil.ros2.publisher import Ros2Publisher

_PUBLISHERS = pytest.StashKey[dict[tuple["Network", str], "Ros2Publisher"]]()


def driven(item: pytest.Item, source: BenchSource) -> BenchSource:
    """Return the bench of a test with the controller of its marker `controller`.

    A ROS 2 participant is kept until the session ends, so that its simulated time never steps back.

    Raises:
        UsageError, ConfigError: the marker is wrong, or the controller cannot be used.
    """
    mark = item.get_closest_marker("controller")
    if mark is None:
        return source
    named = mark.args[0] if len(mark.args) == 1 else None
    domain = mark.kwargs.get("domain")
    known = domain is None or (type(domain) is int and 0 <= domain <= HIGHEST_DOMAIN)
    if not isinstance(named, str) or set(mark.kwargs) - {"domain"} or not known:
        raise UsageError(
            "marker controller",
            expected=f'controller("ros2:/joint_commands", domain=0..{HIGHEST_DOMAIN}), or a law or class',
        )
    if named.startswith(ROS2):
        publisher = _publisher(item.config, named.removeprefix(ROS2), source.config.ros2, domain)
        return replace(source, controller=named, publish=publisher.sink)
    CONTROLLER.check(named)
    if named in LAWS:
        return source.changed(overrides={"control.law": named})
    return replace(source, controller=named)


def _publisher(config: pytest.Config, topic: str, bench: Ros2Config, domain: int | None) -> Ros2Publisher:
    """Return the session's ROS 2 participant in a domain, which subscribes to the topic of a program."""
    if hasattr(config, "workerinput"):
        raise UsageError(
            f"marker controller({ROS2 + topic!r}): one program drives one robot at a time",
            remedy="leave -n out for these tests",
        )
    from hil.ros2.network import must_be_usable, network_of

    must_be_usable()
    from hil.ros2.publisher import Ros2Publisher

    network = network_of(bench, os.environ, domain=domain)
    known = config.stash.setdefault(_PUBLISHERS, {})
    if (network, topic) not in known:
        known[network, topic] = publisher = Ros2Publisher(network, topic)
        config.add_cleanup(publisher.close)
    return known[network, topic]
