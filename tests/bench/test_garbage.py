"""Objects that exist before a drive are left out of the search for garbage while it lasts, and no longer."""

import gc

import pytest

import hil
from hil.robot.trajectories import line
from hil.support.garbage import old_objects_passed_over


@pytest.fixture(autouse=True)
def nothing_left_out():
    before = gc.get_freeze_count()
    gc.unfreeze()
    yield
    gc.unfreeze()
    if before:
        gc.freeze()


def test_a_drive_leaves_out_what_existed_before_it():
    left_out = []

    def look(record):
        left_out.append(gc.get_freeze_count())

    with hil.open_bench("emulated", seed=1) as bench:
        bench.drive(line((0, 0, 0), (0.01, 0, 0), duration_s=1.0), on_cycle=look)
    assert min(left_out) > 10_000
    assert gc.get_freeze_count() == 0


class Loop:
    def __init__(self):
        self.me = self


def test_garbage_of_the_time_itself_is_found():
    gc.collect()
    with old_objects_passed_over():
        found = Loop()
        del found
        assert gc.collect() >= 1


def test_what_somebody_else_left_out_stays_so():
    gc.freeze()
    with old_objects_passed_over():
        pass
    assert gc.get_freeze_count() > 0


def test_it_ends_with_an_error():
    with pytest.raises(ValueError, match="such"), old_objects_passed_over():
        raise ValueError("such")
    assert gc.get_freeze_count() == 0
