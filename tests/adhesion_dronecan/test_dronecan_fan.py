"""A fan that speaks DroneCAN: PyPI `dronecan`'s own node at it, our driver, and a bench."""

import math

import can
import pytest

from hil.bench import open_bench
from hil.config.dronecan import DroneCanConfig
from hil.core.errors import ConfigError, DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.adhesion.dronecan.driver import DroneCanFan
from hil.fakes.motor_controllers.daemon_in_world import DaemonInWorld
from hil.fan_daemon.protocols import protocol_of
from hil.fan_daemon.spec import Spec
from hil.links.can_bus import CanLink
from hil.links.dronecan import library as libraries

dronecan = pytest.importorskip("dronecan", reason="the extra dronecan is not installed")
COMMON = dronecan.driver.common
ESC = dronecan.uavcan.equipment.esc


class OnTheBus(COMMON.AbstractDriver):
    """PyPI dronecan's seam to a CAN adapter, on a bus of python-can."""

    def __init__(self, bus):
        super().__init__()
        self._bus = bus

    def receive(self, timeout=None):
        message = self._bus.recv(0)
        return None if message is None else COMMON.CANFrame(message.arbitration_id, message.data, True)

    def send_frame(self, frame):
        self._bus.send(can.Message(arbitration_id=frame.id, data=bytes(frame.data), is_extended_id=True))

    def close(self):
        pass


@pytest.fixture
def theirs(fan_world):
    """(world, a node of PyPI dronecan beside the fan's, what that node received by type)."""
    with fan_world() as made:
        node = dronecan.node.Node(OnTheBus(made.bus), node_id=10)
        reported = {"Status": [], "NodeStatus": []}
        node.add_handler(ESC.Status, lambda event: reported["Status"].append(event.message))
        node.add_handler(
            dronecan.uavcan.protocol.NodeStatus, lambda event: reported["NodeStatus"].append(event.transfer)
        )
        yield made, node, reported
        node.close()


def spin(made, node, seconds, message=None):
    """World time passes; the node broadcasts every 50 ms."""
    for _ in range(round(20 * seconds)):
        if message is not None:
            node.broadcast(message)
        made.clock.sleep_until_ns(made.clock.now_ns() + 50_000_000)
        for _ in range(40):
            node.spin(0)


@pytest.mark.parametrize("command", [ESC.RawCommand(cmd=[6000]), ESC.RPMCommand(rpm=[28_000])])
def test_pypi_dronecan_drives_the_emulated_fan_and_it_times_out(theirs, command):
    made, node, reported = theirs
    spin(made, node, 3.0, command)
    assert reported["Status"][-1].rpm == pytest.approx(made.node.fan.speed_rpm, abs=100)
    assert 25_000 < made.node.fan.speed_rpm < 33_000
    assert reported["Status"][-1].voltage == pytest.approx(22.9, abs=0.5)
    spin(made, node, 0.95)
    assert made.node.fan.speed_rpm > 25_000
    spin(made, node, 2.5)
    assert made.node.fan.speed_rpm < 2_000


def test_pypi_dronecan_gets_the_node_information(theirs):
    made, node, reported = theirs
    answers = []
    node.request(dronecan.uavcan.protocol.GetNodeInfo.Request(), 42, answers.append)
    spin(made, node, 2.5)
    assert bytes(answers[0].response.name.to_bytes()) == b"org.vesc.emulated"
    assert {t.source_node_id for t in reported["NodeStatus"]} == {42}
    assert len(reported["NodeStatus"]) in (2, 3)


def test_a_command_for_others_is_not_obeyed(theirs):
    made, node, _ = theirs
    spin(made, node, 1.0, ESC.RawCommand(cmd=[]))
    assert made.node.fan.speed_rpm == 0.0


def test_a_node_that_asks_who_others_are_has_not_said_who_it_is(fan_world, driver, monkeypatch):
    asked = dronecan.uavcan.protocol.GetNodeInfo.Request()
    ((frame_id, data),) = libraries.frames_of(
        asked,
        source=42,
        transfer_id=0,
        priority=30,
        dest_node_id=10,
        service_not_message=True,
        request_not_response=True,
    )
    question = can.Message(arbitration_id=frame_id, data=data, is_extended_id=True)
    take = CanLink.take
    monkeypatch.setattr(CanLink, "take", lambda link, *wait: [(0, question), *take(link, *wait)])
    with fan_world() as made:
        fan = driver(made.clock)
        fan.open()
        assert fan.identity()["model"].startswith("org.vesc.emulated")


@pytest.mark.parametrize("command", ["duty", "rpm"])
def test_a_force_is_reached_and_kept_up(command, fan_world, driver, after):
    with fan_world(pack_v=22.5) as made:
        fan = driver(made.clock, command=command)
        fan.open()
        assert fan.identity()["model"].startswith("org.vesc.emulated")
        after(fan, made.clock, 0.3)
        fan.set_force_n(40.0)
        samples = after(fan, made.clock, 6.0)
        made.world.sync_plant()
        assert made.world.plant.truth().adhesion_n == pytest.approx(40.0, rel=0.02)
        newest = samples[-1]
        assert fan._config.force_at_n(newest.speed_rpm) == pytest.approx(40.0, rel=0.02)
        assert 20.0 < newest.input_v < 22.5
        assert newest.fet_c > 25.0
        assert math.isnan(newest.motor_a)
        sent = fan._commander.status()["sent"]
        assert (
            newest.duty == pytest.approx(sent[1], rel=0.05) if command == "duty" else math.isnan(newest.duty)
        )


def test_a_silent_bus_and_the_wrong_node_are_named(fan_world, driver):
    silent = pytest.raises(DeviceTimeoutError, match=r"no DroneCAN node answers.*CAN Mode")
    with fan_world(nodes=()) as made, silent:
        driver(made.clock).open()
    with fan_world() as made:
        with pytest.raises(DeviceError, match=r"no node 43; there: 42.*set adhesion.node_id = 42"):
            driver(made.clock, node_id=43).open()
        with pytest.raises(DeviceError, match=r"no esc.Status with index 1"):
            driver(made.clock, esc_index=1).open()


def test_two_controllers_of_one_index_are_refused(fan_world, driver):
    with fan_world(nodes=((42, 0), (43, 0))) as made, pytest.raises(DeviceError, match="both have index 0"):
        driver(made.clock).open()


def test_a_controller_of_another_index_is_left_alone(fan_world, driver, after):
    with fan_world(nodes=((42, 0), (43, 1))) as made:
        fan = driver(made.clock)
        fan.open()
        assert len(after(fan, made.clock, 1.0)) == pytest.approx(50, abs=2)


def test_damaged_reports_are_dropped_and_frozen_ones_marked(fan_world, driver, after):
    with fan_world(start="running", faults=("adhesion:corrupt@2+2,probability=0.3",)) as made:
        fan = driver(made.clock)
        fan.open()
        samples = after(fan, made.clock, 4.0)
        assert 100 < len(samples) < 195
        assert {s.status for s in samples} == {Status.OK}
        assert all(25_000 < s.speed_rpm < 35_000 for s in samples)
    with fan_world(start="running", faults=("adhesion:stuck@2",)) as made:
        fan = driver(made.clock)
        fan.open()
        assert after(fan, made.clock, 4.0)[-1].status is Status.FROZEN


def test_the_spec_of_the_daemon_is_what_it_takes():
    spec = Spec(**DroneCanConfig(node_id=5, esc_index=2, own_id=9).daemon_spec())
    protocol_of(spec)
    assert (spec.controller_id, spec.details["esc_index"], spec.details["node_id"]) == (5, 2, 9)
    assert set(spec.highest) == {"duty", "erpm"}


def test_without_the_library_the_line_that_installs_it_is_reported(monkeypatch, fan_world):
    monkeypatch.setattr(libraries, "is_installed", lambda extra: False)
    with fan_world(nodes=()) as made, pytest.raises(ConfigError, match=r"needs PyPI dronecan.*dronecan"):
        DroneCanFan(DroneCanConfig(), made.clock, DaemonInWorld(made.world).commander)


def test_a_robot_on_its_wall_is_held_by_one():
    with open_bench("emulated", overrides={"adhesion.model": "dronecan"}) as bench:
        bench.settle(0.5)
        assert bench.truth().adhesion_n == pytest.approx(45.0, rel=0.05)
    assert bench.held.state == "HELD"
