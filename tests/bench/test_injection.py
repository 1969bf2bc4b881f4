"""A bench with faults in front of its devices: a stop ends them, HELD is judged without them."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import pytest

import hil
from hil.bench.bench import Bench
from hil.bench.device_set_from_config import make_device_set, model_of
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.bench.injection import Injection
from hil.bench.opening import make_bench_model
from hil.config.loading import load_bench
from hil.core.device import Connection
from hil.core.errors import FaultNotSupportedError, SafetyStop, UsageError
from hil.core.registry import kinds
from hil.core.signals import Status
from hil.fakes.world import VirtualClock
from hil.faults.fault import parse_fault
from hil.recording.runs import RunStart
from hil.robot.trajectories import line

pytestmark = pytest.mark.usefixtures("warm_commands")


def bench_with(
    *specs: str,
    profile: str = "emulated",
    overrides: Mapping[str, object] = MappingProxyType({}),
    stands: tuple[float, float, float] = (0.0, 0.0, 0.0),
    at_chips: Sequence[str] = (),
) -> Bench:
    """A bench in virtual time whose emulated devices have faults at their links, as real ones do."""
    faults = tuple(map(parse_fault, specs))
    overrides = {"loop.rate_hz": 50.0, **overrides}
    model = make_bench_model(load_bench(profile, overrides=overrides))
    there = load_bench(profile, overrides={**overrides, "environment.start_pose": list(stands)})
    world = build_world(there, seed=2, faults=[*map(parse_fault, at_chips)])
    connected = connect_in_process(model.config, world)
    clock = VirtualClock(world)
    injection = Injection(model.config, clock, faults)
    rig = make_device_set(
        model.config, clock, connected.connections, world.failures, in_front=injection.in_front_of
    )
    bench = Bench(model, clock, rig, world=world, faults=faults, injection=injection)
    bench.on_close(connected.close)
    return bench


def test_a_stop_ends_the_faults_before_the_robot_is_judged():
    with bench_with("servos:silent@3") as bench:
        with pytest.raises(SafetyStop, match="stale_servos"):
            bench.drive(line((0, 0, 0), (0.2, 0, 0), duration_s=6.0), feedback="ekf")
        assert Status.TIMEOUT not in bench.devices.get("servos").read()[0].status  # the link is whole again
    assert bench.held.state == "HELD"
    (row,) = bench.injection.report()
    assert (row["at"], row["begun_s"]) == ("link", 3.0)
    assert 3.05 < row["ended_s"] < 3.3
    assert row["messages"] > 0


def test_a_stop_ends_the_faults_before_it_stops_the_wheels(monkeypatch):
    seen = []
    with bench_with("servos:silent@3") as bench:
        servos = bench.devices.servos
        stop = servos.stop

        def read_and_stop():
            seen.append((bench.world_ns > 3_000_000_000, servos.read()[0].status))
            stop()

        monkeypatch.setattr(servos, "stop", read_and_stop)
        with pytest.raises(SafetyStop, match="stale_servos"):
            bench.drive(line((0, 0, 0), (0.2, 0, 0), duration_s=6.0), feedback="ekf")
    assert Status.TIMEOUT not in next(status for late, status in seen if late)


def test_a_fault_that_has_hit_nothing_is_named_and_one_that_has_is_not():
    with bench_with("tracker:silent@1+1") as bench:
        bench.observe(2.5)
    assert bench.faults_without_effect() == ()
    with bench_with("tracker:drop@1+0.5,probability=1e-6") as bench:
        bench.observe(2.5)
    assert [*map(str, bench.faults_without_effect())] == ["tracker:drop@1+0.5,probability=1e-06"]


def test_a_port_that_a_driver_opens_again_while_it_is_read_keeps_its_faults():
    silent_s = {}
    for where in ("chip", "link"):
        overrides = {"imu": {"backend": "emulated", "model": "microstrain"}}
        config = load_bench("emulated_floor", overrides=overrides)
        fault = parse_fault("imu:unplug@3+1")
        world = build_world(config, seed=2, faults=[fault] if where == "chip" else [])
        connected = connect_in_process(config, world)
        clock = VirtualClock(world)
        injection = Injection(config, clock, [fault] if where == "link" else [])
        injection.follow(clock.now_ns)
        rig = make_device_set(
            config, clock, connected.connections, world.failures, in_front=injection.in_front_of
        )
        imu, seen_ns = rig.get("imu"), []
        imu.open()
        while clock.now_ns() < 5_000_000_000:
            clock.sleep_until_ns(clock.now_ns() + 10_000_000)
            seen_ns += [clock.now_ns()] * any(s.status is Status.OK for s in imu.read())
        imu.close()
        connected.close()
        silent_s[where] = max(b - a for a, b in pairwise(seen_ns)) / 1e9
    assert silent_s["chip"] > 1.0
    assert abs(silent_s["link"] - silent_s["chip"]) < 0.1


def test_a_fault_counts_only_the_messages_that_it_has_hit_itself():
    specs = ("imu:silent@2+1", "imu:corrupt@2+1,probability=1e-6")
    with bench_with(*specs, profile="emulated_floor") as bench:
        bench.observe(3.0)
    silent, corrupt = bench.injection.report()
    assert silent["messages"] > 10
    assert corrupt["messages"] == 0
    assert [*map(str, bench.faults_without_effect())] == [corrupt["fault"]]


def test_with_faults_a_robot_on_a_wall_is_not_led_far():
    with bench_with("imu:drop@3") as bench:
        bench.check(line((0, 0, 0), (0.29, 0, 0), duration_s=9.0))
        with pytest.raises(UsageError, match=r"0\.31 m away"):
            bench.check(line((0, 0, 0), (0.31, 0, 0), duration_s=9.0))


def test_a_robot_that_stands_elsewhere_than_the_bench_file_says_may_go_as_far():
    with bench_with("tracker:silent@3+1", stands=(0.2, 0.0, 0.0)) as bench:
        start = bench.settle()
        there, beyond = (np.add(start, (ahead_m, 0, 0)) for ahead_m in (0.2, 0.35))
        bench.drive(line(start, there, duration_s=6.0))
        with pytest.raises(UsageError, match=r"0\.3\d m away"):
            bench.check(line(there, beyond, duration_s=6.0))


BLIND_BOTH = ("tracker:silent@3+1.5", "mocap:silent@3+1.5")
HEARD = {"thrust": {"backend": "emulated", "model": "vesc"}}
"""Propellers that report their push: load cells alone then show whether the robot can slide."""


def test_cells_that_feel_enough_let_the_robot_go_on_where_no_camera_sees_it():
    with bench_with(*BLIND_BOTH, overrides=HEARD) as bench:
        bench.drive(line((0, 0, 0), (0.05, 0, 0), duration_s=4.0), feedback="ekf")
    assert bench.held.state == "HELD"


def test_cells_that_feel_too_little_stop_it_while_no_camera_sees_it():
    with bench_with(
        *BLIND_BOTH, overrides=HEARD, at_chips=["adhesion:adhesion_loss@3.5,factor=0.4"]
    ) as bench:
        with pytest.raises(SafetyStop) as stop:
            bench.drive(line((0, 0, 0), (0.05, 0, 0), duration_s=6.0), feedback="ekf")
        stopped_s = bench.world_ns / 1e9
    assert stop.value.reason == "adhesion"
    assert 3.5 < stopped_s < 4.0
    assert bench.truth().fallen is False
    assert bench.held.state == "HELD"


def test_the_way_counts_over_all_motions_with_faults():
    with bench_with("imu:drop@1,probability=0.05") as bench:
        bench.drive(line((0, 0, 0), (0.2, 0, 0), duration_s=6.0), start_pose=(0, 0, 0))
        bench.check(line((0.2, 0, 0), (0.29, 0, 0), duration_s=9.0))
        with pytest.raises(UsageError, match=r"0\.36 m away"):
            bench.check(line((0.2, 0, 0), (0.36, 0, 0), duration_s=9.0))
        bench.look()  # ends the faults
        bench.check(line((0.2, 0, 0), (0.36, 0, 0), duration_s=9.0))


@pytest.mark.parametrize(
    "specs",
    [
        ("imu:drop@1,probability=0.05",),
        ("mocap:drop@1,probability=0.5",),
        ("tracker:delayed@1,delay_s=0.01", "mocap:delayed@1,delay_s=0.01"),
    ],
)
def test_a_robot_that_goes_too_far_with_faults_is_stopped_whatever_drives_it(specs):
    goal = line((0, 0, 0), (0.6, 0, 0), duration_s=14.0)
    with bench_with(*specs) as bench:
        start = RunStart(bench.start_state((0, 0, 0)), "ekf", bench.config.control.law, (), goal.to_mapping())
        pipeline = bench.make_pipeline(goal, feedback="ekf")
        bench.devices.actuators().enable()
        with pytest.raises(SafetyStop, match="since its first motion"):
            bench.run(pipeline, start, lambda record: False)
        gone_m = bench.truth().pose_body_in_wall[0]
    assert 0.3 < gone_m < 0.34
    assert bench.held.state == "HELD"


REAL = {"imu.backend": "real", "imu.port": "/dev/no-such-port"}


@pytest.mark.opens_stand_ins
def test_both_consents_are_needed_before_anything_is_opened():
    permitted = {"faults.real": "wall", "faults.devices": ["imu"]}
    fault = ("imu:silent@2",)
    with pytest.raises(FaultNotSupportedError, match="--inject-real"):
        hil.open_bench("emulated", overrides={**REAL, **permitted}, faults=fault)
    with pytest.raises(FaultNotSupportedError, match="permits faults of real devices nowhere"):
        hil.open_bench("emulated", overrides=REAL, faults=fault, inject_real=True)
    hil.open_bench("emulated", overrides={**REAL, **permitted}, faults=fault, inject_real=True).close()


@pytest.mark.opens_stand_ins
@pytest.mark.real_time
def test_served_devices_that_count_as_real_have_faults_at_their_links():
    served = [sys.executable, "-m", "hil.cli", "emulate", "--bench", "emulated_floor", "--only", "imu,mocap"]
    child = subprocess.Popen(served, stdout=subprocess.PIPE, text=True)
    try:
        ends, config = json.loads(child.stdout.readline()), load_bench("emulated_floor")
        overrides = {"faults.real": "floor", "faults.devices": ["imu", "mocap"]}
        for name in ("imu", "mocap"):
            reached = model_of(config, name).connection(ends[kinds()[name].shown_as])
            values = reached.values if isinstance(reached, Connection) else reached
            overrides |= {f"{name}.backend": "real", **{f"{name}.{k}": v for k, v in values.items()}}
        for name in ("servos", "encoders", "tracker", "adhesion", "load_cells", "thrust"):
            if name in config.devices():
                overrides[name] = None
        faults = ("imu:silent@8+0.5", "mocap:drop@8+1,probability=0.5")
        with hil.open_bench("emulated_floor", overrides=overrides, faults=faults, inject_real=True) as bench:
            while bench.world_ns < 10_000_000_000:
                bench.devices.read(0)
                bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    finally:
        child.terminate()
        child.communicate(timeout=20)
    assert bench.faults_without_effect() == ()
    assert [row["ended_s"] for row in bench.injection.report()] == [8.5, 9.0]
