"""A device that is named as people call it: the error asks for the name it has on the bench."""

import pytest

from hil.core.errors import FaultNotSupportedError
from hil.core.registry import kinds, which_device
from hil.fakes.active_faults import FaultPlan
from hil.fakes.fault import parse_fault


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("camera", "tracker"),
        ("Camra", "tracker"),
        ("trackr", "tracker"),
        ("fan", "adhesion"),
        ("motion_capture", "mocap"),
    ],
)
def test_nouns_and_aliases_of_kinds_lead_to_their_devices(word, meant):
    assert which_device(word, kinds()) == f"did you mean {meant}?"


def test_only_what_is_there_is_asked_for():
    assert which_device("camera", ["imu", "servos"]) == ""
    assert which_device("zzz", kinds()) == ""


def test_a_fault_of_the_camera_asks_for_the_tracker():
    plan = FaultPlan([parse_fault("camera:off@1")])
    for device in ("imu", "tracker"):
        plan.declare(device, {"off": ()})
    with pytest.raises(FaultNotSupportedError, match="did you mean tracker"):
        plan.check()
