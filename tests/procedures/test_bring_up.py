"""Bring-up finds signs and clocks as they were hidden, and names what is wrong."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from procedure_runs import AS_SHIPPED, assert_covered, fragment_of, part, run, true_world

from hil.bench import open_bench
from hil.config.assumed_parameters import turned
from hil.config.loading import load_bench
from hil.core.clock import nanoseconds
from hil.fakes.mocap.natnet.chip import NatNetServer
from hil.fakes.tracker.t265.chip import T265
from hil.loop.control_loop import ControlLoop
from hil.procedure.tracking_errors import enable_hold
from hil.procedures.bring_up import Parameters, measurements
from hil.procedures.bring_up.body_sensor import wrong_axes, wrong_turns
from hil.procedures.bring_up.jogs import DriveJogs, SteerJogs, exchanged_axes, exchanged_drives, expected_push
from hil.procedures.bring_up.streams import judge_stream
from hil.support.file_reading import get_dotted

SHORT = {"watch_s": 4.0}
BRIEF = {"watch_s": 2.0}
"""For what does not depend on how the devices' clocks drift."""


def believed(seed, wrong):
    """Signs in the bench file of which some are wrong; the robot's are all 1."""
    rng = np.random.default_rng([seed, 5])

    drive, steer = ([1 if not wrong or rng.random() < 0.7 else -1 for _ in range(4)] for _ in range(2))
    if wrong:
        drive[rng.integers(4)] = -1
    return {"alignment.drive_sign": drive, "alignment.steer_sign": steer}


def bring_up(seed, folder, wrong, parameters=SHORT):
    """The run; the signs that it leaves and its verdict are those of the hidden truth."""
    done = run("bring_up", folder, parameters, seed=seed, overrides=AS_SHIPPED | believed(seed, wrong))
    done.assert_held()
    assert fragment_of(folder)["alignment"] == {"drive_sign": [1] * 4, "steer_sign": [1] * 4}
    assert done.result.verdict.value in (("FAIL",) if wrong else ("PASS", "MARGINAL")), done.failed
    return done


def clock_ratios(seed, done):
    """Errors of the clocks' drifts over their stated uncertainties."""
    world = true_world("emulated", seed)
    true_ppm = {
        "tracker": 1e6 * (1.0 / part(world, T265)._stretch - 1.0),
        "mocap": 1e6 * (part(world, NatNetServer)._stretch - 1.0),
    }
    return [
        (done.values[f"{n}.clock_drift"] - true_ppm[n]) / done.values[f"{n}.clock_drift_uncertainty"]
        for n in true_ppm
    ]


@pytest.fixture(scope="module")
def as_configured(tmp_path_factory):
    return bring_up(3, tmp_path_factory.mktemp("bring_up") / "run", wrong=False)


def assert_gap_is_reported(done, slept_s):
    """The largest gap is a cycle and what this computer slept, and reported as its own where it slept."""
    gap_ms = done.values["loop.largest_gap"]
    assert gap_ms == pytest.approx(1e3 * slept_s + 10.0, abs=1.0)
    reported = [note for note in done.result.facts["notes"] if "This computer was late itself" in note]
    assert [f"{gap_ms:.0f} ms" in note for note in reported] == [True] * bool(slept_s)


def test_a_computer_that_made_no_gaps_is_not_blamed(as_configured):
    assert_gap_is_reported(as_configured, 0.0)


def test_gaps_that_this_computer_made_are_reported_as_its_own(tmp_path, monkeypatch):
    cycle, cycles = ControlLoop.cycle, iter(range(10**6))

    def at_times_late(loop, deadline_ns):
        if next(cycles) == 150:
            loop.clock.sleep_until_ns(deadline_ns + nanoseconds(0.06))
        return cycle(loop, deadline_ns)

    monkeypatch.setattr(ControlLoop, "cycle", at_times_late)
    parameters = BRIEF | {"devices": "servos,imu,mocap"}  # lies wrong: it is watched, and nothing moves
    done = run(
        "bring_up", tmp_path / "run", parameters, bench="emulated_floor", overrides=AS_SHIPPED | STANDS_UP
    )
    assert_gap_is_reported(done, 0.06)


def test_bring_up_passes_on_a_bench_as_configured_and_finds_its_clocks(as_configured):
    done = as_configured
    assert_covered(clock_ratios(3, done), few=True)
    assert done.values["devices"] == 8
    assert done.values["encoders.clock_drift"] == pytest.approx(-30.0, abs=1.0)
    assert done.values["tracker.age"] > done.values["encoders.age"] > done.values["mocap.age"] > 0.0


def test_bring_up_finds_wrong_signs_and_leaves_the_right_ones(tmp_path):
    done = bring_up(4, tmp_path / "run", True, BRIEF | {"devices": "servos,mocap"})
    assert done.result.exit_code == 1
    assert any("reversed" in note for note in done.result.facts["notes"])
    assert "body" not in [s["title"] for s in done.result.facts["steps"]]


OTHERS = itertools.product(("vesc", "dronecan"), ("teensy", "vesc"), (100.0, 50.0))


@pytest.mark.parametrize(
    ("fan", "propellers", "rate_hz", "seeds"),
    [
        ("vesc", "teensy", 100.0, (1, 3)),
        ("dronecan", "vesc", 50.0, (2, 4)),
        *(pytest.param(*case, range(1, 6), marks=pytest.mark.long) for case in OTHERS),
    ],
)
def test_what_holds_the_robot_is_young_enough_whenever_it_reports(fan, propellers, rate_hz, seeds):
    """A seed chooses when in a cycle controllers report; where they report slower that phase stays."""
    overrides = {"adhesion.model": fan, "thrust.model": propellers, "loop.rate_hz": rate_hz}
    holding = ("adhesion", "thrust", "load_cells")
    for seed in seeds:
        found = ages_ms(overrides, holding, seed=seed)
        assert {name: age for name, (age, limit) in found.items() if not 0.0 <= age <= limit} == {}


def ages_ms(overrides, names=("servos", "encoders", "imu", "mocap"), seed=0):
    """(age at rest, age allowed) by device, as bring_up judges them."""
    with open_bench("emulated", seed=seed, overrides={"tracker": None, **overrides}) as bench:
        enable_hold(bench)
        motion, config = bench.observe(1.0, feedback="odometry"), bench.config
    limits = {m.name: m.high for m in measurements(Parameters(), config)}
    return {
        name: (1e3 * judge_stream(name, motion, config).age_s[0], limits[f"{name}.age"]) for name in names
    }


@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
def test_what_was_asked_for_ahead_is_a_cycle_old(rate_hz):
    found = ages_ms({"loop.rate_hz": rate_hz, "servos.prefetch": True})
    assert {name: age for name, (age, limit) in found.items() if not 0.0 <= age <= limit} == {}
    assert (found["servos"][0] > 5.0) is (rate_hz < 200.0)


@pytest.mark.parametrize("late_s", [0.0, 0.015])
def test_a_capture_is_not_blamed_for_frames_in_bunches_and_is_for_lost_ones(late_s):
    """Late frames are stamped in bunches, as in the public recordings; at last a third of all is lost."""
    shares = []
    for gaps_per_s in (0.0, 1.3, 12.0):
        laws = {"emulation.mocap.stamp_late_s": late_s, "emulation.mocap.gaps_per_s": gaps_per_s}
        with open_bench("emulated_floor", seed=2, overrides=laws) as bench:
            motion = bench.observe(4.0, feedback="odometry")
            shares.append(judge_stream("mocap", motion, bench.config).delivered)
            frames = [s.stamp.seq for r in motion.records for s in r.inputs.mocap]
        if gaps_per_s:
            assert shares[-1] == pytest.approx(len(frames) / (frames[-1] - frames[0] + 1), abs=0.04)
    assert min(shares[:2]) > 0.8 > shares[2]


def test_servos_that_answer_late_are_too_old():
    overrides = {"servos.reply_slack_s": 0.02, "emulation.servos": {"processing_s": 0.012}}
    age, limit = ages_ms(overrides | {"loop.rate_hz": 50.0})["servos"]
    assert age > limit


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_hidden_signs_and_clocks_come_back_over_twenty_seeds(tmp_path):
    runs = [(seed, bring_up(seed, tmp_path / str(seed), seed % 4 > 0)) for seed in range(20)]
    ratios = [r for seed, done in runs for r in clock_ratios(seed, done)]
    assert_covered(ratios, few=False)


def jogs(angle_rad, order, signs=(1, 1, 1, 1)):
    """Drives in this order, of a robot whose every push is as it should be, but for some noise."""
    config = load_bench("emulated")
    reach_m = float(np.hypot(config.robot.wheel_x_m[0], config.robot.wheel_y_m[0]))
    expected = expected_push(config, angle_rad, reach_m)
    noise = np.random.default_rng(3).normal(scale=0.05, size=(4, 3))
    found = (expected * np.array(signs)[:, None])[list(order)] + noise
    found /= np.linalg.norm(found, axis=1)[:, None]
    return DriveJogs(
        angle_rad, expected, found, np.ones(4), found / [1.0, 1.0, reach_m], found[:, 2] / reach_m
    )


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_drives_and_axes_in_any_other_order_are_named(order):
    moved = {k: other for k, other in enumerate(order) if k != other}
    assert exchanged_drives(jogs(0.0, order), jogs(np.pi / 2.0, order)) == moved
    assert exchanged_axes(SteerJogs(np.eye(4), np.eye(4)[list(order)])) == moved


def test_a_jog_that_motion_capture_did_not_see_accuses_nobody():
    """Its poses were late on a busy computer: that is no frame whose axes are turned."""
    straight, across = jogs(0.0, range(4)), jogs(np.pi / 2.0, range(4))
    turned = replace(straight, moved=straight.moved * [1.0, 1.0, -1.0])
    assert "mocap.body" in wrong_turns("mocap", turned, across)
    blind = replace(turned, moved=np.where(np.eye(4, 3, dtype=bool), np.nan, turned.moved))
    for one in (blind, replace(straight, moved=np.full((4, 3), np.nan))):
        assert not wrong_turns("mocap", one, across)
        assert not wrong_axes("mocap", one, across)


@pytest.mark.long
def test_an_age_that_the_bench_file_makes_is_told_with_its_key(tmp_path):
    wrong = {"tracker.latency_s": 0.15, "emulation.tracker.latency_s": 0.02}
    done = run("bring_up", tmp_path / "run", BRIEF, overrides=wrong)
    assert "tracker.age" in done.failed
    notes = "".join(done.result.facts["notes"])
    assert "tracker.latency_s" in notes
    assert "mocap.body" not in notes, "slipping wheels are no other place of the markers"


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "order"),
    [
        ("servos.drive_ids", (1, 2, 0, 3)),
        ("servos.steer_ids", (3, 0, 1, 2)),
        ("encoders.signals", (1, 2, 3, 0)),
    ],
)
def test_the_right_order_is_told(tmp_path, key, order):
    true = get_dotted(load_bench("emulated").model_dump(), key)
    said = [true[k] for k in order]
    wrong = {key: said, f"emulation.{key}": list(true)}
    done = run("bring_up", tmp_path / "run", BRIEF, overrides=wrong)
    assert done.result.verdict.value == "FAIL"
    assert f"{key} = {list(true)}" in "".join(done.result.facts["notes"])


@pytest.mark.parametrize("signs", [(1, 1, 1, 1), (1, -1, 1, 1), (-1, 1, -1, 1)])
def test_reversed_drives_are_not_taken_for_exchanged_ones(signs):
    rounds = [jogs(angle_rad, range(4), signs) for angle_rad in (0.0, np.pi / 2.0)]
    assert exchanged_drives(*rounds) == {}
    assert exchanged_axes(SteerJogs(np.eye(4), np.diag(signs))) == {}
    assert exchanged_axes(SteerJogs(np.eye(4), np.full((4, 4), np.nan))) == {}


STANDS_UP = {"emulation.imu": {"mount_rotation_wxyz": [0.5**0.5, 0.0, 0.5**0.5, 0.0]}}


@pytest.mark.parametrize(("profile", "verdict"), [("emulated", "FAIL"), ("emulated_floor", "ERROR")])
def test_a_robot_that_stands_otherwise_than_the_bench_file_says_fails_unmoved(tmp_path, profile, verdict):
    """As its IMU shows it: level on a wall, or upright on a floor, where it is unknown what must hold it."""
    parameters = BRIEF | {"devices": "servos,imu,mocap"}
    done = run("bring_up", tmp_path / "run", parameters, bench=profile, overrides=STANDS_UP)
    assert (done.result.verdict.value, done.result.error) == (verdict, None)
    assert "contradicted" in done.failed
    assert "environment.tilt_rad" in "".join(done.result.facts["notes"])
    assert ["tilted by 90 deg" in e.message for e in done.result.teardown_errors] == [True] * (
        verdict == "ERROR"
    )
    assert [s["title"] for s in done.result.facts["steps"]] == ["identity", "streams"]
    assert "nothing was moved" in done.result.to_json()["said"]


def turned_mounts(axis, degrees, *devices):
    """A bench file with turned mounts, and devices that are mounted straight."""
    straight = (1.0, 0.0, 0.0, 0.0)
    keys = [f"{device}.mount_rotation_wxyz" for device in devices]
    return {k: turned(axis, degrees)(straight) for k in keys} | {f"emulation.{k}": straight for k in keys}


@pytest.mark.parametrize(
    ("profile", "mounts"),
    [
        ("emulated_floor", ("z", 90.0, "tracker")),
        pytest.param("emulated_floor", ("z", 180.0, "tracker"), marks=pytest.mark.long),
        ("emulated", ("x", 90.0, "tracker", "imu")),
    ],
)
def test_turned_mounts_that_gravity_does_not_show_are_not_blamed_on_wheels(tmp_path, profile, mounts):
    """Without motion capture, and about the vertical: gravity is right, and so is every wheel."""
    overrides = turned_mounts(*mounts) | {"mocap": None}
    parameters = BRIEF | {"devices": "servos,encoders,imu,tracker"}
    done = run("bring_up", tmp_path / "run", parameters, bench=profile, overrides=overrides)
    assert done.result.exit_code == 1
    notes = "".join(done.result.facts["notes"])
    assert [f"{device}.mount_rotation_wxyz" in notes for device in mounts[2:]] == [True] * len(mounts[2:])
    assert not [key for key in ("drive_sign", "steer_sign", "encoders.sign", "drive_ids") if key in notes]


@pytest.mark.parametrize("wrong", [{"drive_sign": [-1] * 4}, {"steer_sign": [-1] * 4}])
def test_wheels_that_all_go_the_wrong_way_are_not_blamed_on_the_camera(tmp_path, wrong):
    overrides = {f"alignment.{key}": value for key, value in wrong.items()} | {"mocap": None}
    parameters = BRIEF | {"devices": "servos,imu,tracker"}
    done = run("bring_up", tmp_path / "run", parameters, bench="emulated_floor", overrides=overrides)
    notes = "".join(done.result.facts["notes"])
    assert [f"alignment.{key}: [1, 1, 1, 1] fits" in notes for key in wrong] == [True]
    assert "mount_rotation_wxyz" not in notes


@pytest.mark.long
def test_an_imu_that_is_turned_about_the_vertical_stands_as_the_bench_file_says(tmp_path):
    turned = {"emulation.imu": {"mount_rotation_wxyz": [0.5**0.5, 0.0, 0.0, 0.5**0.5]}}
    done = run("bring_up", tmp_path / "run", BRIEF | {"devices": "servos,imu,mocap"}, overrides=turned)
    assert done.values["contradicted"] == 0.0, "a mount is found by a procedure"
    assert "imu.gyro_response" in done.values, "the body was moved"


@pytest.mark.long
def test_devices_that_work_badly_fail_their_own_measurements(tmp_path):
    faults = ("encoder.FL:stuck", "tracker:slow,factor=2")
    parameters = BRIEF | {"devices": "servos,encoders,tracker"}
    done = run("bring_up", tmp_path / "run", parameters, faults=faults)
    assert done.result.exit_code == 1
    assert {"steer_FL.encoder_response", "tracker.delivered"} <= set(done.failed)
    assert not {"steer_BL.encoder_response", "encoders.delivered"} & set(done.failed)
    done.assert_held()


def test_a_device_that_does_not_answer_is_named_before_torque_comes_on(tmp_path):
    done = run("bring_up", tmp_path / "run", SHORT, faults=("servo.drive_BR:off",))
    assert (done.result.exit_code, done.result.error.step) == (3, "start")
    assert "servos" in done.result.error.message


def test_a_device_that_falls_silent_is_named_and_the_robot_held(tmp_path):
    parameters = BRIEF | {"devices": "servos,imu,mocap"}
    done = run("bring_up", tmp_path / "run", parameters, faults=("imu:off@2",))
    assert done.result.exit_code == 3
    assert done.result.error.step in ("streams", "steering")
    assert "imu" in done.result.error.message
    done.assert_held()


SMALL = {"encoders": None, "imu": None, "mocap": None}


def test_devices_that_a_smaller_bench_lacks_are_named_before_it_is_opened(tmp_path):
    named = SHORT | {"devices": "servos,encoders,imu,tracker,mocap"}
    refused = run("bring_up", tmp_path / "refused", named, overrides=SMALL)
    assert refused.result.exit_code == 2
    assert "encoders, imu, mocap" in refused.result.error.message
    assert not refused.source.benches


@pytest.mark.long
def test_bring_up_of_a_smaller_bench_looks_at_what_it_is_reported(tmp_path):
    done = run("bring_up", tmp_path / "run", BRIEF | {"devices": "servos,tracker"}, overrides=SMALL)
    assert done.result.verdict.value in ("PASS", "MARGINAL"), done.failed or done.result.error
    done.assert_held()
