"""`hil emulate` on a wall: a robot without a hold slides, and the first line and the last say so."""

import re
from contextlib import contextmanager

import pytest

from hil.bench import open_bench, open_emulation
from hil.bench.hold.emulated_support import EmulatedSupport
from hil.config.loading import load_bench

pytestmark = pytest.mark.usefixtures("warm_commands")


@contextmanager
def served(profile, only=("servos",)):
    """The served robot of a profile, and a way to let its time pass."""
    config = load_bench(profile, emulate=("all",))
    server = open_emulation(config, only=only)
    try:
        robot = EmulatedSupport(config, server.world, "servos" in server.transports)
        yield robot, lambda s: server.world.advance_to(server.world.now_ns + round(s * 1e9))
    finally:
        server.close()


def test_a_robot_that_no_client_has_enabled_does_not_slide_and_is_not_held():
    with served("emulated") as (robot, let_pass):
        assert robot.at_the_start().startswith("at the start NOT HELD: ")
        assert "let go when a client enables torque" in robot.at_the_start()
        let_pass(4.0)
        assert robot.at_the_end() == (
            "at the end NOT HELD: no client has enabled torque; the robot was held by hand"
        )


def test_without_servos_it_is_never_let_go():
    with served("emulated", only=("imu",)) as (robot, _):
        assert "no servos are served" in robot.at_the_start()


def test_on_the_floor_there_is_nothing_to_say():
    with served("emulated_floor") as (robot, let_pass):
        let_pass(0.5)
        assert (robot.at_the_start(), robot.at_the_end()) == ("", "")


def test_torque_holds_it_and_without_torque_it_slides():
    """The bench's own drivers as the client, in virtual time."""
    with open_bench("emulated") as bench:
        robot = EmulatedSupport(bench.config, bench.world, servos=True)
        bench.observe(1.0)
        assert robot.at_the_end().startswith("at the end HELD: ")
        bench.devices.servos.release()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 3_000_000_000)
        assert re.fullmatch(
            r"at the end NOT HELD: the robot (slides at \d+ mm/s|has left its wall), \d+ mm from .*",
            robot.at_the_end(),
        )
