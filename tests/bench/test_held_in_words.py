"""What a user reads of how a robot was left: the last word must not say more than anybody has seen."""

import numpy as np
import pytest

from hil.bench.hold.held_state import Held, abandoned, held_in_words, lacking_in_words
from hil.core.signals import SERVOS, ServoHold


@pytest.mark.parametrize(
    ("held", "words"),
    [
        (Held("HELD", 0.0003, "torque on"), "HELD: moved 0.3 mm since the stop; torque on"),
        (Held("NOT HELD", 0.012, "it slides"), "NOT HELD: moved at least 12.0 mm since the stop; it slides"),
        (Held("NOT HELD", None, "not checked"), "NOT HELD: not checked"),
    ],
)
def test_a_way_is_reported_where_it_was_measured_and_as_the_least_where_the_robot_is_lost(held, words):
    assert str(held) == held_in_words(held.to_json()) == words


@pytest.mark.parametrize(
    ("state", "wanted", "lost"),
    [
        ("NOT HELD", True, True),
        ("NOT HELD", False, False),
        ("HELD", True, False),
        ("not needed", True, False),
    ],
)
def test_lost_is_a_robot_that_should_be_held_and_is_not(state, wanted, lost):
    assert Held(state, None, "", wanted).lost is lost


def test_a_robot_whose_bench_ended_is_lost_on_a_wall_and_needs_no_hold_on_the_floor():
    on_wall, on_floor = (abandoned("the process was killed", on_wall=on_wall) for on_wall in (True, False))
    assert (on_wall.state, on_wall.lost, on_wall.moved_m) == ("NOT HELD", True, None)
    assert (on_floor.state, on_floor.lost) == ("not needed", False)
    assert "the process was killed" in on_wall.why
    assert "the process was killed" in on_floor.why


@pytest.mark.parametrize(
    ("trouble", "named"),
    [
        (dict.fromkeys(SERVOS, "timeout"), False),
        (dict.fromkeys(SERVOS[:7], "timeout"), True),
        ({**dict.fromkeys(SERVOS, "timeout"), "drive_FL": "no torque"}, True),
    ],
    ids=["no answer", "one answers", "one answers and has no torque"],
)
def test_all_that_are_silent_have_one_cause_and_others_are_named(trouble, named):
    hold = ServoHold(0, np.zeros(8), True, trouble)
    words = lacking_in_words(hold, emulated=False)
    assert ("no servo answers: check the servos' supply" in words) is not named
    assert all((f"{name} ({text})" in words) is named for name, text in trouble.items())
    assert words == f"{lacking_in_words(hold, emulated=True)}: secure the robot"
