"""The forward model is chosen by recordings that the fit did not see, and the choice says how clear it is."""

import numpy as np
import pytest

from hil.calibration import choice as choice_module
from hil.calibration.choice import Choice, candidates, choose
from hil.calibration.problem import make_setting
from hil.calibration.synthetic import hidden_robot, make_set
from hil.vocabulary.errors import DataError

SETTING = make_setting("recommended")
BRIEF = ("line_x", "line_y", "circle_ccw")


def found(contact, seed=3):
    robot = hidden_robot(seed, contact=contact)
    recordings = make_set(robot, seed, BRIEF, repetitions=2, run_to_run=0.2, slip_share=0.0)
    return choose(recordings, candidates(SETTING, robot.nominal.geometry), seed=0)


def test_dry_contact_is_read_by_the_model_of_dry_friction():
    choice = found("coulomb")
    assert choice.best.setting.model == "dry-friction", choice.held_out_m
    assert choice.held_out_m["dry friction"] < 0.8 * choice.held_out_m["exact"]


def test_where_contact_is_viscous_dry_friction_is_not_taken():
    assert found("viscous").best.setting.model != "dry-friction"


def test_what_belongs_together_is_left_out_together(monkeypatch):
    """Repetitions of one round are alike: a model that reads these need not read the next round."""
    robot, seen = hidden_robot(1), []
    recordings = make_set(robot, 1, BRIEF[:1], repetitions=4)

    def judged(recordings, groups, candidate):
        seen.append(list(groups))
        return np.ones(len(recordings))

    monkeypatch.setattr(choice_module, "_held_out", judged)
    among = candidates(SETTING, robot.nominal.geometry)[:2]
    for groups in ((), (0, 0, 0, 0), (0, 0, 1, 1)):
        choose(recordings, among, seed=0, groups=groups)
    assert [len(set(groups)) for groups in seen[::2]] == [4, 4, 2]
    assert seen[-1] == [0, 0, 1, 1]


def test_the_choice_says_how_clear_it_was():
    among = candidates(SETTING, hidden_robot(1).nominal.geometry)
    close = Choice(among[0], {"exact": 2.0e-3, "dry friction": 2.01e-3}, 0.6)
    assert "exact, 2.00 mm; dry friction 2.01 mm" in close.in_words()
    assert "60 %: no clear choice" in close.in_words()


def test_without_a_repetition_to_leave_out_nothing_is_chosen():
    robot = hidden_robot(1)
    recordings = make_set(robot, 1, BRIEF, repetitions=1)
    with pytest.raises(DataError, match="at least two"):
        choose(recordings, candidates(SETTING, robot.nominal.geometry), seed=0)
