"""What `--ros2` and the options beside it ask for, as long as a command runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from hil.cli.bench_options import BenchRequest
from hil.core.errors import UsageError
from hil.core.interfaces import Sink

MakeSink = Callable[[Mapping[str, Any]], Sink]


@contextmanager
def published(request: BenchRequest) -> Iterator[MakeSink | None]:
    """Be on ROS 2, if that is asked for.

    Returns:
        What makes a bench's sink from its header; None without `--ros2`.

    Raises:
        UsageError: options that mean nothing without `--ros2`, no such domain or interface.
        ConfigError: the extra is missing.
    """
    if not request.ros2:
        beside = {
            "--ros2-domain": request.ros2_domain is not None,
            "--ros2-interface": request.ros2_interface,
        }
        for option in (name for name, given in beside.items() if given):
            raise UsageError(f"{option} says where --ros2 publishes", remedy=f"give --ros2, or no {option}")
        yield None
        return
    from hil.ros2.network import Network, domain_of, must_be_usable

    must_be_usable()
    from hil.ros2.publisher import Ros2Publisher

    network = Network(domain_of(request.ros2_domain, os.environ), request.ros2_interface)
    publisher = Ros2Publisher(network)
    try:
        click.echo(f"ROS 2: {network.in_words()}", err=True)
        if network.reaches_out:
            click.echo(
                f"hil: whoever reaches {network.interface} can read this bench: ROS 2 has no password",
                err=True,
            )
        yield publisher.sink
    finally:
        publisher.close()
