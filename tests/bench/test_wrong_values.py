"""A bench file with a wrong number, and hardware with the true one: the key is named before or soon."""

import contextlib
import json
import math

import numpy as np
import pytest

import hil
from hil.bench.doctor.examination import examine
from hil.config.assumed_parameters import order, plus, turned
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, SafetyStop
from hil.core.signals import WHEELS
from hil.loop.checks.wrong_parameter import explained
from hil.robot.trajectories import line

ONE = (1.0, 0.0, 0.0, 0.0)
UP = line((0, 0, 0), (0.1, 0, 0), speed_m_s=0.05)


def wrong(key, said, true):
    """A bench file that says one value, and a world where another is true."""
    return {key: said, f"emulation.{key}": true}


def opened(overrides, profile="emulated", seed=0):
    return hil.open_bench(profile, overrides={"loop.rate_hz": 50.0, **overrides}, seed=seed)


def examined(overrides, profile="emulated"):
    bench = opened(overrides, profile)
    failed = [f for f in examine(bench, watch_s=0.4) if f.level == "failure"]
    return {row.key: row for row in bench.parameters.rows()}, failed


@pytest.mark.parametrize(
    ("device", "axis", "degrees"), [("imu", "z", 6.0), ("imu", "y", 90.0), ("tracker", "z", -10.0)]
)
def test_a_mount_that_two_others_contradict_is_named_with_the_right_one(device, axis, degrees):
    key = f"{device}.mount_rotation_wxyz"
    rows, failed = examined(wrong(key, turned(axis, degrees)(ONE), ONE))
    contradicted = {name for name, row in rows.items() if row.state == "contradicted"}
    assert contradicted == {key}
    assert any(key in f.found for f in failed)
    if axis == "z":
        off = np.array(rows[key].says) - np.array(ONE)
        assert np.linalg.norm(off) < 0.02


@pytest.mark.parametrize("up_axis", ["y", "z"])
@pytest.mark.parametrize(
    ("option", "axis", "degrees"),
    [
        ("plane_rotation_wxyz", "z", 12.0),
        ("body_rotation_wxyz", "z", -12.0),
        ("plane_rotation_wxyz", "x", 12.0),
        ("body_rotation_wxyz", "y", 12.0),
    ],
)
def test_a_plane_or_a_rigid_body_with_other_axes_is_named(option, axis, degrees, up_axis):
    overrides = {"mocap.up_axis": up_axis, f"emulation.mocap.{option}": turned(axis, degrees)(ONE)}
    rows, _ = examined(overrides)
    assert rows["mocap.body"].state == "contradicted"
    assert abs(rows["mocap.body"].difference) == pytest.approx(math.radians(abs(degrees)), abs=0.02)
    assert rows["imu.mount_rotation_wxyz"].state != "contradicted"
    assert rows["mocap.up_axis"].state == ("unconfirmed" if axis == "z" else "contradicted")


def test_gravity_shows_a_mount_but_for_a_turn_about_the_vertical():
    rows, _ = examined({})
    for device in ("imu", "tracker"):
        row = rows[f"{device}.mount_rotation_wxyz"]
        assert row.state == "unconfirmed"
        assert "a turn about the vertical" in row.by
        assert abs(row.difference) < 0.03
    assert rows["environment.tilt_rad"].state == rows["mocap.body"].state == "confirmed"


def test_two_mounts_that_are_turned_alike_are_named_beside_what_they_contradict():
    turn, keys = turned("z", 7.0)(ONE), ("imu.mount_rotation_wxyz", "tracker.mount_rotation_wxyz")
    rows, failed = examined(wrong(keys[0], turn, ONE) | wrong(keys[1], turn, ONE))
    assert rows["mocap.body"].state == "contradicted"
    assert any(all(key in f.found for key in ("mocap.body", *keys)) for f in failed)


@pytest.mark.parametrize(
    ("true", "state"), [(1.2, "contradicted"), (1.49, "unconfirmed"), (math.pi / 2.0, "confirmed")]
)
def test_a_slope_that_imu_and_camera_show_otherwise_is_not_confirmed(true, state):
    rows, _ = examined({"emulation.environment.tilt_rad": true})
    assert rows["environment.tilt_rad"].state == state
    assert rows["environment.tilt_rad"].difference == pytest.approx(true - math.pi / 2.0, abs=0.03)


def test_with_two_sources_either_may_be_wrong():
    turned_by = wrong("imu.mount_rotation_wxyz", turned("z", 30.0)(ONE), ONE)
    rows, _ = examined({**turned_by, "tracker": None})
    assert {k for k, row in rows.items() if row.state == "contradicted"} == {
        "imu.mount_rotation_wxyz",
        "mocap.body",
    }


@pytest.mark.parametrize("seed", [3, 8])
@pytest.mark.parametrize("profile", ["emulated", "emulated_floor"])
def test_a_right_bench_is_never_contradicted(profile, seed):
    with opened({}, profile, seed) as bench:
        bench.drive(UP, hold_s=0.1)
    assert not bench.parameters.contradicted()
    assert not bench.seen.contradicting


def test_nothing_is_driven_by_a_filter_with_a_mount_that_is_contradicted():
    with opened(wrong("imu.mount_rotation_wxyz", turned("z", 90.0)(ONE), ONE)) as bench:
        with pytest.raises(ConfigError, match=r"imu\.mount_rotation_wxyz"):
            bench.drive(UP)
        assert abs(bench.truth().pose_body_in_wall[0]) < 0.001
        bench.drive(UP, feedback="odometry", hold_s=0.1)


def test_zeros_of_encoders_and_servos_have_to_fit():
    rows, failed = examined({"alignment.steer_zero_rad": plus(0.0, 0.2)((0.0,) * 4)})
    assert rows["alignment.steer_zero_rad"].state == rows["encoders.zero_rad"].state == "contradicted"
    assert any("alignment.steer_zero_rad" in f.found and "BL" in f.found for f in failed)


@pytest.mark.parametrize(
    ("key", "said", "true", "low", "high"),
    [("robot.mass_kg", 1.95, 3.25, 3.0, 3.6), ("thrust.full_force_n", 59.6, 39.7, 3.8, 4.6)],
)
def test_the_work_of_the_drives_shows_the_weight(key, said, true, low, high):
    """The mass that is told holds if the push is as commanded, so a weaker push looks like a larger mass."""
    with opened(wrong(key, said, true)) as bench:
        with pytest.raises(SafetyStop, match=key.replace(".", r"\.")) as stop:
            bench.drive(UP)
        assert bench.truth().pose_body_in_wall[0] < 0.06
    assert stop.value.reason == "weight"
    assert low < float(str(stop.value).split("the mass would be ")[1].split(" kg")[0]) < high
    assert bench.held.state == "HELD"


@pytest.mark.parametrize("said", [(-0.049, 0.4, 0.079), (-0.049, -0.0065, 0.3)])
def test_a_centre_of_mass_that_asks_for_more_adhesion_is_among_the_keys_to_look_at(said):
    key = "robot.centre_of_mass_m"
    bench = opened(wrong(key, said, (-0.049, -0.0065, 0.079)))
    with pytest.raises(SafetyStop, match=r"robot\.centre_of_mass_m") as stop, bench:
        pass
    assert stop.value.reason == "adhesion"
    assert {row.key: row.state for row in bench.parameters.rows()}[key] == "unconfirmed"


def test_a_radius_is_told_with_the_factor_that_fits():
    bench = opened(wrong("robot.wheel_radius_m", (0.0508,) * 4, (0.0254,) * 4))
    with bench, pytest.raises(SafetyStop, match=r"robot\.wheel_radius_m"):
        bench.drive(UP)
    assert bench.seen.contradicting["robot.wheel_radius_m"].factor == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("plant", ["own", "mujoco"])
@pytest.mark.parametrize("wheel", range(4))
def test_one_wheel_of_another_radius_is_told_from_the_other_three(wheel, plant):
    true, said = (0.0254,) * 4, tuple(0.0254 * (1.3 if i == wheel else 1.0) for i in range(4))
    with opened({**wrong("robot.wheel_radius_m", said, true), "emulation.plant": plant}) as bench:
        bench.drive(UP, hold_s=0.1)
    contradicting = bench.seen.contradicting["robot.wheel_radius_m"].message
    assert f"wheel {WHEELS[wheel]} " in contradicting
    assert "smaller than the 33.0 mm" in contradicting
    rows = {row.key: row for row in bench.parameters.rows()}
    assert rows["robot.wheel_radius_m"].state == "contradicted"


@pytest.mark.parametrize(("said", "true"), [(0.25, 0.02), (0.02, 0.25)])
def test_a_delay_is_told_from_a_scale(said, true):
    """Its steps differ by a share of the speed, not of the way."""
    key = "tracker.latency_s"
    with opened({"loop.rate_hz": 100.0, **wrong(key, said, true)}) as bench:
        start = bench.settle()
        with contextlib.suppress(SafetyStop):
            bench.drive(line(start, start + np.array([0.1, 0.0, 0.0]), speed_m_s=0.05), hold_s=0.5)
    said = " ".join(row["what"] for row in bench.seen.rows())
    assert (key in said, "tracker.scale" in said) == (True, False)


def test_camera_and_imu_that_share_a_turned_plate_do_not_outvote_wheels_and_motion_capture():
    turn, keys = turned("x", 180.0)(ONE), ["imu.mount_rotation_wxyz", "tracker.mount_rotation_wxyz"]
    with opened(wrong(keys[0], turn, ONE) | wrong(keys[1], turn, ONE)) as bench:
        start = bench.settle()
        bench.drive(line(start, start + np.array([0.0, 0.0, 0.12])), feedback="odometry", hold_s=0.1)
    assert set(keys) <= set(bench.seen.contradicting)
    assert not {k for k in bench.seen.contradicting if k.startswith(("servos.", "robot.", "alignment."))}


def test_left_for_right_shows_in_a_turn():
    bench = opened(wrong("servos.drive_ids", order(3, 2, 1, 0)((1, 2, 3, 4)), (1, 2, 3, 4)))
    with bench, pytest.raises(SafetyStop, match=r"servos\.drive_ids"):
        bench.drive(line((0, 0, 0), (0, 0, 0.15)))


@pytest.mark.parametrize("end", [(0.0, 0.06, 0.0), (0.0, 0.0, 0.12)])
def test_the_other_up_axis_shows_across_and_in_turns(end):
    with opened(wrong("mocap.up_axis", "z", "y")) as bench:
        start = bench.settle()
        bench.drive(line(start, start + np.array(end)), hold_s=0.1)
    assert "mocap.up_axis" in bench.seen.contradicting


@pytest.mark.parametrize("end", [(0.0, 0.06, 0.0), (0.0, 0.0, 0.12)])
@pytest.mark.parametrize("by_deg", [0.0, 90.0])
def test_a_camera_turned_about_the_vertical_shows_across_and_in_turns(end, by_deg):
    """Its gravity is right: only motion shows it."""
    key = "tracker.mount_rotation_wxyz"
    with opened(wrong(key, turned("x", by_deg)(ONE), ONE)) as bench:
        start = bench.settle()
        bench.drive(line(start, start + np.array(end)), feedback="odometry", hold_s=0.1)
    assert (key in bench.seen.contradicting) == bool(by_deg)


@pytest.mark.parametrize(
    ("key", "said", "true"), [("adhesion.rated_force_n", 22.5, 45.0), ("thrust.full_rpm", 18000.0, 9000.0)]
)
def test_what_nothing_measures_is_named_where_it_lets_the_robot_go(key, said, true):
    vesc = {"thrust.model": "vesc"} if key.startswith("thrust") else {}
    bench = opened({**wrong(key, said, true), **vesc, "load_cells": None})
    with pytest.raises(SafetyStop, match=key.replace(".", r"\.")), bench:
        bench.drive(UP)


@pytest.mark.parametrize(
    ("key", "said", "true"),
    [
        ("adhesion.pole_pairs", 4, 3),
        ("adhesion.rpm_per_v", 875.0, 1750.0),
        ("thrust.rpm_per_v", 1800.0, 900.0),
        ("thrust.pole_pairs", 14, 7),
    ],
)
def test_the_key_of_a_stop_is_contradicted(key, said, true):
    vesc = {"thrust.model": "vesc"} if key.startswith("thrust") else {}
    bench = opened({**wrong(key, said, true), **vesc, "load_cells": None})
    with pytest.raises(SafetyStop), bench:
        bench.drive(UP)
    rows = {row.key: row.state for row in bench.parameters.rows()}
    assert rows[key] == "contradicted"
    assert rows["robot.mass_kg"] == "unconfirmed"


def test_a_fan_that_is_too_weak_contradicts_no_number():
    bench = opened({**wrong("adhesion.rated_force_n", 22.5, 45.0), "load_cells": None})
    with pytest.raises(SafetyStop, match="adhesion"), bench:
        bench.drive(UP)
    assert "contradicted" not in {row.state for row in bench.parameters.rows()}


@pytest.mark.parametrize(
    ("source", "ratio", "turns", "key"),
    [
        ("tracker", 0.8, False, "tracker.scale"),
        ("servos", -1.0, False, "alignment.drive_sign"),
        ("mocap", complex(0.9, 0.4), False, "mocap.body"),
        ("imu", 0.1, True, "imu.mount_rotation_wxyz"),
        ("tracker", 0.02, False, None),
        ("servos", 1.03, False, None),
        ("tracker", 20.0, False, None),
    ],
)
def test_a_constant_ratio_is_a_parameter_and_a_frozen_sensor_is_none(source, ratio, turns, key):
    found = explained(source, complex(ratio), turns=turns)
    assert (found.key if found else None) == key


def test_what_is_true_is_checked_as_the_bench_file_is():
    with pytest.raises(ConfigError) as refused:
        opened({"emulation.robot": {"mass_kg": 0.0}})
    assert "emulation.robot.mass_kg" in str(refused.value)


def test_a_horn_that_is_screwed_on_turned_turns_the_wheel():
    with opened({"emulation.servos.horn_rad": [0.3, 0, 0, 0], "emulation.geometry_share": 0.0}) as bench:
        rest = bench.observe(0.1, feedback="odometry").records[-1].inputs.servos[-1]
    assert rest.position_rad[4] == pytest.approx(0.3, abs=0.01)
    assert rest.position_rad[5] == pytest.approx(0.0, abs=0.01)


def test_mirrored_wheels_are_refused():
    with pytest.raises(ConfigError) as refused:
        load_bench("emulated", overrides={"robot.wheel_y_m": [-0.1, -0.1, 0.1, 0.1]})
    assert "robot.wheel_y_m" in "".join(refused.value.problems)


def test_every_parameter_has_a_row_of_plain_values():
    rows, _ = examined({})
    for row in rows.values():
        entry = json.loads(json.dumps(row.to_json(), allow_nan=False))
        assert set(entry) == {"key", "value", "state", "by", "on", "says", "difference", "within", "unit"}
        assert row.by, row.key
    assert rows["adhesion.pole_pairs"].state == "confirmed"
    assert math.isfinite(rows["adhesion.pole_pairs"].difference)


@pytest.mark.parametrize("said", [39.7, 47.6])
def test_weight_and_push_rest_on_each_other(said):
    """The drives show their difference: a heavier robot that is pushed more looks the same."""
    with opened(wrong("thrust.full_force_n", said, 39.7)) as bench:
        bench.drive(UP, hold_s=0.1)
    rows = {row.key: row for row in bench.parameters.rows()}
    push, mass = rows["thrust.full_force_n"], rows["robot.mass_kg"]
    assert push.state == mass.state == "unconfirmed"
    agrees = said == 39.7
    assert ("robot.mass_kg" in push.by, "thrust.full_force_n" in mass.by) == (agrees, agrees)
    assert (abs(push.difference) <= push.within) == agrees


def test_a_climb_confirms_the_weight_and_a_stop_contradicts_it():
    states = {}
    for said in (1.5, 0.9):
        bench = opened(
            {**wrong("robot.mass_kg", said, 1.5), "thrust": None, "robot.thrust_compensation": 0.0}
        )
        with bench, contextlib.suppress(SafetyStop):
            bench.drive(UP, hold_s=0.1)
        states[said] = {row.key: row for row in bench.parameters.rows()}["robot.mass_kg"]
    assert (states[1.5].state, states[0.9].state) == ("confirmed", "contradicted")
    assert abs(states[1.5].difference) <= states[1.5].within == 0.1


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_fan_and_load_cells_that_are_wrong_alike_confirm_nothing(factor):
    cells = load_bench("emulated").load_cells.n_per_count
    said = {"adhesion.rated_force_n": 45.0 * factor, "load_cells.n_per_count": [factor * n for n in cells]}
    rows, _ = examined(
        said | {"emulation.adhesion.rated_force_n": 45.0, "emulation.load_cells.n_per_count": cells}
    )
    rated, scale = rows["adhesion.rated_force_n"], rows["load_cells.n_per_count"]
    assert rated.state == scale.state == "unconfirmed"
    assert scale.key in rated.by
    assert abs(rated.difference) <= rated.within <= 0.1


@pytest.mark.parametrize("seed", [0, 1])
def test_horns_as_delivered_are_neither_confirmed_nor_contradicted(seed):
    """One is up to 2.5 deg off; encoders show more than good zeros may differ."""
    examined = opened({"emulation.geometry_share": 1.0}, seed=seed)
    list(examine(examined, watch_s=0.4))
    row = {row.key: row for row in examined.parameters.rows()}["alignment.steer_zero_rad"]
    assert row.state == "unconfirmed"
    assert ("which show" in row.by) == (abs(row.difference) > row.within)


@pytest.mark.parametrize("cells", [True, False])
def test_a_power_that_does_not_belong_to_the_speed_points_to_its_ratings(cells):
    without = {} if cells else {"load_cells": None}
    rows, _ = examined({**wrong("adhesion.rated_input_a", 60.0, 30.0), **without})
    contradicted = {key for key, row in rows.items() if row.state == "contradicted"}
    assert {"adhesion.rated_input_a", "adhesion.rated_input_v"} <= contradicted
    assert ("adhesion.rated_rpm" in contradicted) is not cells
    assert rows["adhesion.rated_input_a"].says == pytest.approx(30.0, rel=0.15)


def test_poles_and_volts_that_are_wrong_by_one_factor_are_both_named():
    rows, failed = examined(
        {
            "adhesion.pole_pairs": 4,
            "adhesion.rpm_per_v": 1312.5,
            "emulation.adhesion.pole_pairs": 3,
            "emulation.adhesion.rpm_per_v": 1750.0,
            "load_cells": None,
        }
    )
    assert rows["adhesion.pole_pairs"].state == rows["adhesion.rpm_per_v"].state == "contradicted"
    assert any("adhesion.pole_pairs and adhesion.rpm_per_v both" in one.found for one in failed)


def test_what_the_robot_stands_on_is_taken_for_granted():
    rows, _ = examined({"environment.friction": 0.6})
    assert rows["environment.surface"].state == rows["environment.friction"].state == "unconfirmed"


@pytest.mark.parametrize("off_rad", [0.05, -0.05])
def test_zeros_that_are_all_off_alike_are_seen(off_rad):
    rows, _ = examined({"alignment.steer_zero_rad": [off_rad] * 4})
    assert rows["alignment.steer_zero_rad"].state == "contradicted"
    assert rows["alignment.steer_zero_rad"].says == pytest.approx([0.0] * 4, abs=0.02)
