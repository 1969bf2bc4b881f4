"""What was changed between repetitions is told from what it does in each motion, or said not to be known."""

from dataclasses import replace

import numpy as np
import pytest

from hil.calibration.synthetic import MOTIONS, hidden_robot, make_set
from hil.cli import main
from hil.datasets.plain_csv import write_plain
from hil.datasets.truth_correction import corrected
from hil.datasets.truth_sessions import with_other_sessions
from hil.datasets.unlike_repetitions import with_unlike_repetitions

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def healthy():
    return make_set(hidden_robot(6, contact="elastic"), 6, MOTIONS, 4)


def number(one):
    return int(one.name.rsplit("_", 1)[1])


def turned(one, by_rad):
    return replace(one, truth_pose=one.truth_pose + np.array([0.0, 0.0, by_rad]))


def tracked(one, ahead_m, left_m):
    pose = one.truth_pose.copy()
    way = (ahead_m + 1j * left_m) * np.exp(1j * pose[:, 2])
    pose[:, 0] += way.real
    pose[:, 1] += way.imag
    return replace(one, truth_pose=pose)


def steered(one, wheels, by_rad):
    return replace(one, steering_rad=one.steering_rad + by_rad * np.isin(np.arange(4), wheels))


def rolled(one, wheel, factor):
    return replace(one, wheel_angle_rad=one.wheel_angle_rad * np.where(np.arange(4) == wheel, factor, 1.0))


def late_sessions(change):
    return lambda one: change(one) if number(one) > 2 else one


def odd(change):
    return lambda one: change(one) if number(one) % 2 else one


def one_of_four(change):
    return lambda one: change(one) if number(one) == 3 else one


def said_of(recordings):
    return {one.name: one.contradictions[0] for one in recordings if one.contradictions}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (late_sessions(lambda one: turned(one, 0.05)), "0.05 rad off theirs, or all its steering angles"),
        (late_sessions(lambda one: steered(one, range(4), 0.05)), "all its steering angles (delta) are"),
        (late_sessions(lambda one: steered(one, [1], 0.03)), "the BL wheel alone, as if delta2 were -0.03"),
        (late_sessions(lambda one: rolled(one, 3, 1.03)), "the FR wheel alone, as if phi4 grew 0.97"),
        (odd(lambda one: rolled(one, 2, 0.98)), "the BR wheel alone, as if phi3 grew 0.9"),
        (late_sessions(lambda one: tracked(one, 0.04, 0.02)), "tracks a point 4"),
        (late_sessions(lambda one: turned(tracked(one, 0.04, 0.0), 0.08)), "heading of its ground truth"),
        (lambda one: turned(one, (0.03, -0.02, 0.05, 0.08)[number(one) - 1]), "heading of its ground truth"),
        (
            lambda one: turned(
                tracked(one, (0.02, -0.03, 0.05, 0.0)[number(one) - 1], 0.02 * number(one)),
                (0.03, -0.05, 0.08, 0.0)[number(one) - 1],
            ),
            "heading of its ground truth",
        ),
    ],
    ids=[
        *("heading", "four zeros", "a zero", "a radius", "lost counts", "point", "body", "each another"),
        "a body each day",
    ],
)
def test_what_differs_is_named_and_none_of_as_many_is_kept(healthy, spoil, words):
    """Of the motions that show it, all repetitions contradict; lines show no tracked point."""
    found = said_of(with_unlike_repetitions([spoil(one) for one in healthy]))
    assert len({name.rsplit("_", 1)[0] for name in found}) >= 4
    assert len(found) >= 16
    assert all("which is right is not known" in said for said in found.values())
    assert any(words in said for said in found.values())
    causes = ("wheel alone", "all its steering angles (delta)", "heading of its", "tracks a point")
    others = [cause for cause in causes if cause not in words and words not in cause]
    if "heading" not in words and "rad off" not in words:
        assert not any(cause in said for cause in others for said in found.values())


@pytest.mark.parametrize(
    "change", [lambda one: turned(one, 0.05), lambda one: steered(one, [1], 0.05)], ids=["heading", "a zero"]
)
def test_one_against_three_that_agree_is_left_out(healthy, change):
    found = said_of(with_unlike_repetitions([one_of_four(change)(one) for one in healthy]))
    assert {name[-2:] for name in found} == {"_3"}
    assert all("3 other repetitions of its motion, which agree" in said for said in found.values())


def test_wheels_that_all_differ_otherwise_are_given_in_numbers(healthy):
    """No cause explains them: another robot, or several zeros."""
    by_rad = np.array([0.05, -0.04, 0.02, -0.03])
    spoil = late_sessions(lambda one: replace(one, steering_rad=one.steering_rad + by_rad))
    found = said_of(with_unlike_repetitions([spoil(one) for one in healthy]))
    assert len(found) == len(healthy)
    assert all("no single wheel, heading or tracked point explains" in said for said in found.values())


@pytest.mark.parametrize("seed", range(20, 28))
def test_slip_noise_and_tolerances_are_no_difference(seed):
    contact = ("viscous", "coulomb", "creep", "elastic")[seed % 4]
    data = make_set(
        hidden_robot(seed, contact=contact), seed, MOTIONS, 2 + seed % 3, slip_share=0.25 * (seed % 3)
    )
    assert with_unlike_repetitions(data) == data
    assert with_other_sessions(data) == data


def test_a_heading_of_one_motion_is_told_by_the_others(healthy):
    """Two repetitions differ: the one whose heading the other motions have is kept."""
    some = [one for one in healthy if number(one) < 3]
    spoilt = [turned(one, 0.08) if one.name == "line_y_2" else one for one in some]
    assert set(said_of(corrected(spoilt))) == {"line_y_2"}


def test_scale_of_turns_alone_is_not_said_to_be_one_of_all_positions(healthy):
    """With another tracked point circles are longer, and lines are not."""
    found = with_other_sessions([late_sessions(lambda one: tracked(one, 0.0, 0.04))(one) for one in healthy])
    said = [one.contradictions[-1] for one in found if one.contradictions]
    assert said
    assert all("only recordings that turn show it" in words for words in said)


def test_no_calibration_is_written_of_sessions_with_other_headings(healthy, tmp_path, capsys):
    for one in healthy:
        write_plain(tmp_path / f"{one.name}.csv", late_sessions(lambda one: turned(one, 0.04))(one))
    assert main(["calibrate", str(tmp_path), "--no-validation", "--out", str(tmp_path / "c.toml")]) == 2
    assert "which is right is not known" in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()
