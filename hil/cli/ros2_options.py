"""Publishes the benches of a command on ROS 2, as `--ros2` and the options beside it say."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hil.cli.bench_options import BenchRequest
from hil.core.errors import UsageError

if TYPE_CHECKING:
    from hil.config.bench import BenchConfig
    from hil.ros2.publisher import Ros2Publisher


@contextmanager
def published(
    request: BenchRequest, config: BenchConfig, *, patient: bool = False
) -> Iterator[Ros2Publisher | None]:
    """Join ROS 2 for the duration of the block, if the command line asks for it.

    Args:
        request: request of the command line.
        config: configuration of the bench.
        patient: True to wait without a timeout for a program that drives.

    Returns:
        The publisher of benches; None without `--ros2` and without a controller on ROS 2.

    Raises:
        UsageError: options that mean nothing without `--ros2`, no such domain or interface.
        ConfigError: the extra is missing.
    """
    if not (request.ros2 or request.ros2_topic):
        beside = {
            "--ros2-domain": request.ros2_domain is not None,
            "--ros2-interface": request.ros2_interface,
        }
        for option in (name for name, given in beside.items() if given):
            raise UsageError(f"{option} says where --ros2 publishes", remedy=f"give --ros2, or no {option}")
    if request.ros2_wait is not None and not request.ros2_topic:
        raise UsageError(
            "--ros2-wait is for a controller on ROS 2", remedy="give --controller ros2:TOPIC, too"
        )
    if not (request.ros2 or request.ros2_topic):
        yield None
        return
    from hil.ros2.network import must_be_usable, network_of

    must_be_usable()
    from hil.ros2.publisher import Ros2Publisher

    network = network_of(
        config.ros2, os.environ, domain=request.ros2_domain, interface=request.ros2_interface
    )
    publisher = Ros2Publisher(network, request.ros2_topic, patient=patient)
    try:
        click.echo(f"ROS 2: {network.in_words()}", err=True)
        if network.reaches_out:
            does = "drive this robot" if request.ros2_topic else "read this bench"
            warning = f"hil: any program that reaches {network.interface} can {does}: ROS 2 has no password"
            click.echo(warning, err=True)
        yield publisher
    finally:
        publisher.close()
