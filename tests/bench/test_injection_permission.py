"""What may be injected in front of real devices, and where: refused before anything is opened."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.injected_travel import cells_suffice, seeing_a_slide
from hil.config.loading import load_bench
from hil.core.errors import FaultNotSupportedError
from hil.faults.fault import parse_fault
from hil.faults.permission import check

WIRES = {
    "servos": "bus",
    "imu": "bus",
    "encoders": "can",
    "tracker": "poses",
    "mocap": "udp",
    "adhesion": "can",
    "thrust": "",
    "load_cells": "can",
}


def refused(
    *specs: str,
    present: str = "wall",
    most: str = "wall",
    named: tuple[str, ...] = tuple(WIRES),
    by_hand: bool = False,
) -> str:
    """Why faults are refused; empty where they are not."""
    try:
        check(
            [parse_fault(one) for one in specs],
            bench="lab",
            wires=WIRES,
            seeing=("tracker", "mocap", "load_cells"),
            named=named,
            most=most,
            present=present,
            by_hand=by_hand,
        )
    except FaultNotSupportedError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("spec", ["thrust:drop@3+1", "adhesion:drop@3+1", "thrust:off@3+1"])
def test_on_a_wall_what_holds_the_robot_is_the_reason_whatever_its_wire(spec):
    assert "which holds the robot" in refused(spec)


@pytest.mark.parametrize(
    ("present", "most", "allowed"),
    [
        ("floor", "none", False),
        ("floor", "floor", True),
        ("tethered", "floor", False),
        ("tethered", "tethered", True),
        ("wall", "tethered", False),
        ("wall", "wall", True),
    ],
)
def test_the_bench_file_says_how_far_it_goes(present, most, allowed):
    assert (not refused("imu:drop@2", present=present, most=most)) is allowed


def test_a_device_that_the_bench_file_does_not_name_has_no_faults():
    assert "not in [faults] devices" in refused("imu:drop@2", present="floor", named=("tracker",))


@pytest.mark.parametrize("kind", ["off", "brownout", "reset"])
def test_faults_of_the_power_are_refused_with_the_remedy(kind):
    assert "silent" in refused(f"imu:{kind}@2", present="floor")


@pytest.mark.parametrize(
    ("specs", "present", "allowed"),
    [
        (("servos:off@2+1",), "floor", True),
        (("thrust:reset@2",), "tethered", True),
        (("servos:off@2+1",), "wall", False),
        (("adhesion:brownout@2",), "wall", False),
        (("mocap:off@2+1",), "wall", True),
        (("mocap:off@2+1", "tracker:silent@9+1", "load_cells:silent@9+1"), "wall", False),
        (("imu:off@2+1,probability=1",), "floor", False),
        (("imu:stuck@2",), "floor", False),
    ],
)
def test_a_hand_switches_no_power_that_holds_the_robot(specs, present, allowed):
    assert (not refused(*specs, present=present, by_hand=True)) is allowed


@pytest.mark.parametrize(
    "spec",
    [
        "servos:stuck@2",
        "imu:wrong@2",
        "tracker:jump@2",
        "encoders:bus_off@2",
        "servos:silent@2,direction=both",
    ],
)
def test_what_a_link_cannot_do_or_would_do_to_the_device_is_refused(spec):
    assert refused(spec, present="floor")


def test_a_delay_from_the_start_cannot_be_told_from_the_interface():
    assert refused("mocap:delayed@0", present="floor")
    assert not refused("mocap:delayed@1", present="floor")


@pytest.mark.parametrize(
    "spec", ["adhesion:drop@2+1", "thrust:drop@2+1", "servos:garbage@2+0.5", "imu:garbage@2"]
)
def test_on_a_wall_nothing_that_holds_and_no_random_content(spec):
    assert refused(spec)


@pytest.mark.parametrize(
    ("spec", "allowed"),
    [("servos:silent@2+1", True), ("servos:silent@2+1.1", False), ("servos:drop@2", False)],
)
def test_on_a_wall_the_servos_answer_again_within_a_second(spec, allowed):
    assert (not refused(spec)) is allowed


@pytest.mark.parametrize(
    ("specs", "allowed"),
    [
        (("tracker:silent@2+2", "mocap:silent@3+2"), True),
        (("tracker:silent@2+2", "mocap:silent@3+2", "load_cells:silent@3.5+1"), False),
        (("tracker:silent@2+2", "mocap:silent@3+2", "load_cells:silent@4.5+1"), True),
        (("tracker:silent@2", "mocap:silent@3", "load_cells:silent@9"), False),
    ],
)
def test_on_a_wall_one_sensor_that_sees_a_slide_has_no_fault_at_any_time(specs, allowed):
    assert (not refused(*specs)) is allowed
    assert not refused(*specs, present="tethered")


TIMES = st.tuples(st.integers(1, 20), st.none() | st.integers(1, 20))


@given(
    plans=st.lists(st.tuples(st.sampled_from(("tracker", "mocap", "load_cells", "imu")), TIMES), max_size=6)
)
def test_a_plan_is_refused_exactly_where_at_some_time_no_sensor_sees_a_slide(plans):
    specs = [f"{name}:silent@{at}" + (f"+{lasts}" if lasts else "") for name, (at, lasts) in plans]
    struck = [
        {name for name, (at, lasts) in plans if at <= t and (lasts is None or t < at + lasts)}
        for t in range(50)
    ]
    blind = any({"tracker", "mocap", "load_cells"} <= names for names in struck)
    assert bool(refused(*specs)) is blind


def test_load_cells_count_only_where_nothing_that_they_do_not_feel_carries_the_robot():
    unheard = load_bench("emulated")
    heard = load_bench("emulated", overrides={"thrust": {"backend": "emulated", "model": "vesc"}})
    strong = load_bench("emulated", overrides={"adhesion.force_n": 95.0, "adhesion.rated_force_n": 120.0})
    assert not cells_suffice(unheard)  # propellers that say nothing carry a part of the weight
    assert cells_suffice(heard)
    assert cells_suffice(strong)
    assert seeing_a_slide(unheard) == ("tracker", "mocap")
