"""Recorded and emulated runs told apart: the classifier, the repeated commands, and the command line."""

import json
import math

import numpy as np
import pytest

from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import DataError
from hil.datasets.nominal_robot import Nominal
from hil.datasets.read import read_recordings
from hil.twin.compare import compare, compared
from hil.twin.repeat import repeated
from hil.twin.two_sample_test import auc, separation

RATE_RAD_S, MOTION_S, REST_S = 1.5, 9.0, 1.5
RIPPLE = {"emulation.servos.ripple_counts": [[5.0]] * 4}


def write_line(folder, motion, number, along):
    """A run as plain CSV: rest, an even line, rest; wheels of the nominal radius, a count of noise."""
    draws = np.random.default_rng(number)
    t = np.arange(0.0, MOTION_S + 2 * REST_S, 0.016)
    turned = RATE_RAD_S * np.clip(t - REST_S, 0.0, MOTION_S)
    rate = np.where((t > REST_S) & (t < REST_S + MOTION_S), RATE_RAD_S, 0.0)
    way = Nominal().radius_m * turned
    rows = [
        *[turned + draws.normal(0.0, 0.0005, len(t)) for _ in range(4)],
        *[np.full(len(t), along) for _ in range(4)],
        way * math.cos(along) + draws.normal(0.0, 1e-5, len(t)),
        way * math.sin(along) + draws.normal(0.0, 1e-5, len(t)),
        draws.normal(0.0, 1e-4, len(t)),
        *[rate + draws.normal(0.0, 0.01, len(t)) for _ in range(4)],
    ]
    names = "t,phi1,phi2,phi3,phi4,delta1,delta2,delta3,delta4,x,y,theta,w1,w2,w3,w4"
    path = folder / f"{motion}_{number}.csv"
    np.savetxt(path, np.column_stack([t, *rows]), delimiter=",", header=names, comments="", fmt="%.7f")


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lines")
    for number in (1, 2):
        write_line(folder, "line_x", number, 0.0)
        write_line(folder, "line_y", number, math.pi / 2)
    return folder


def emulated(lines, seed, **keys):
    config = load_bench("emulated_floor", overrides=keys)
    only = {name: None for name in config.devices() if name not in ("servos", "mocap")}
    safety = config.safety.model_copy(update={"tracking_error_limit_m": 1.0})
    config = config.model_copy(update={**only, "safety": safety})
    return [repeated(one, config, seed + k) for k, one in enumerate(read_recordings([lines]))]


@pytest.fixture(scope="module")
def plain(lines):
    return emulated(lines, 10)


def test_the_emulated_robot_goes_where_the_recorded_one_was_told_to_go(lines, plain):
    for one, other in zip(read_recordings([lines]), plain, strict=True):
        assert other.motion == one.motion
        turned = [run.wheel_angle_rad[-1] - run.wheel_angle_rad[0] for run in (one, other)]
        assert turned[1] == pytest.approx(turned[0], rel=0.03)
        np.testing.assert_allclose(other.steering_rad[-1], one.steering_rad[-1], atol=0.01)
        moved = [run.truth_pose[-1, :2] - run.truth_pose[0, :2] for run in (one, other)]
        np.testing.assert_allclose(moved[1], moved[0], atol=0.06)


def test_robots_that_differ_by_their_seed_are_alike_and_ripple_tells_them_apart(lines, plain):
    same = {s.group: s.auc for s in compared(plain, emulated(lines, 20)).signals}
    rippled = {s.group: s.auc for s in compared(plain, emulated(lines, 20, **RIPPLE)).signals}
    assert same["wheel angles"] < 0.8
    assert rippled["wheel angles"] > 0.95
    assert rippled["heading"] == pytest.approx(same["heading"], abs=0.2)


def test_a_shift_of_normal_features_is_told_apart_as_far_as_it_can_be():
    """Two normal distributions that lie d standard deviations apart have an AUC of Phi(d / sqrt(2))."""
    draws = np.random.default_rng(4)
    for shift in (0.0, 1.0, 3.0):
        one, other = ({name: list(draws.normal(at, 1.0, (600, 1))) for name in "abcd"} for at in (0.0, shift))
        assert separation(one, other) == pytest.approx(0.5 * (1.0 + math.erf(shift / 2.0)), abs=0.03)


def test_a_wider_spread_is_seen_and_a_single_motion_judges_nothing():
    draws = np.random.default_rng(5)
    one, other = ({name: list(draws.normal(0.0, size, (400, 2))) for name in "ab"} for size in (1.0, 3.0))
    assert separation(one, other) > 0.85
    assert math.isnan(separation({"a": one["a"]}, {"a": other["a"]}))
    assert auc(np.array([0.0, 1.0]), np.array([1.0, 2.0])) == 0.875


def test_the_command_ends_with_1_where_signals_are_told_apart_and_writes_its_page(lines, tmp_path, capsys):
    page = tmp_path / "twin.html"
    code = main(["twin", "compare", str(lines), "--page", str(page), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert code == (0 if found["verdict"] == "PASS" else 1)
    assert [s["group"] for s in found["signals"]][:2] == ["drive rates", "wheel angles"]
    assert len(found["figures"]) == 6
    assert all((f["low"] <= f["recorded"] <= f["high"]) == f["inside"] for f in found["figures"])
    failed = any(s["alike"] is False for s in found["signals"])
    assert (code == 1) == (failed or not all(f["inside"] for f in found["figures"]))
    assert "told apart" in page.read_text() or not failed


def test_a_bench_without_emulated_capture_is_refused(lines, capsys):
    assert main(["twin", "compare", str(lines), "--bench", "sensors"]) == 2
    assert "no emulated servos" in capsys.readouterr().err


def test_recordings_without_a_velocity_register_are_refused(lines, tmp_path):
    rows = (lines / "line_x_1.csv").read_text().splitlines()
    (tmp_path / "line_x_1.csv").write_text("\n".join(row.rsplit(",", 4)[0] for row in rows))
    with pytest.raises(DataError, match="velocity register"):
        compare(read_recordings([tmp_path]), load_bench("emulated_floor"))
