"""Notes of an odometry calibration: what is said of several recordings stands there once."""

from hil.procedures.odometry_calibration.report import joined


def test_warnings_of_several_recordings_are_joined_under_their_own_names():
    names = [f"circle_ccw_{k}" for k in range(1, 7)]
    said = [f"{name}: a wheel slips" for name in names]
    reported = joined([*said, "line_x_1: a gap", "the prior decides: x_w"], {*names, "line_x_1"})
    assert reported == [
        "circle_ccw_1, circle_ccw_2, circle_ccw_3, circle_ccw_4 and 2 more: a wheel slips",
        "line_x_1: a gap",
        "The prior decides: x_w",
    ]
