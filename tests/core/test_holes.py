"""Numbers that are none are found wherever a sample has them, and by the channel that they are of."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.contract import interface_promises
from hil.bench.contract.device_under_test import Broken
from hil.core.device import DeviceKind
from hil.core.geometry import Array
from hil.core.nonfinite import unmarked_nonfinite_fields
from hil.core.registry import kinds
from hil.core.signals import AdhesionSample, Inputs, Stamp, Status
from hil.loop.checks.sensor_status import SensorStatus

OK, LOST = Status.OK, Status.TIMEOUT
STAMP = Stamp(0, 0, 0)


@dataclass(frozen=True)
class Inner:
    value: float


@dataclass(frozen=True)
class Sample:
    stamp: Stamp
    status: Status | tuple[Status, ...] = OK
    value: float = 1.0
    pair: tuple[float, ...] = (1.0, 2.0)
    vector: Array = field(default_factory=lambda: np.ones(3))
    named: Mapping[str, float] = field(default_factory=dict)
    inner: Inner = Inner(1.0)
    maybe: float | None = None


class Thing(DeviceKind):
    name, noun, sample, package = "thing", "thing", Sample, "evil 1.0"


KIND = Thing()


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({}, []),
        ({"value": math.nan}, ["value"]),
        ({"value": -math.inf, "maybe": math.nan}, ["value", "maybe"]),
        ({"pair": (1.0, math.inf)}, ["pair"]),
        ({"vector": np.array([0.0, np.nan])}, ["vector"]),
        ({"named": {"x": math.nan}}, ["named"]),
        ({"inner": Inner(math.nan)}, ["inner"]),
        ({"value": math.nan, "status": LOST}, []),
        ({"pair": (1.0, math.nan), "status": (OK, LOST)}, []),
        ({"pair": (math.nan, 1.0), "status": (OK, LOST)}, ["pair"]),
        ({"vector": np.array([[1.0, 2.0], [np.nan, 2.0]]), "status": (OK, LOST)}, []),
        ({"vector": np.array([[np.nan, 2.0], [1.0, 2.0]]), "status": (OK, LOST)}, ["vector"]),
        ({"vector": np.full(3, np.nan), "status": (OK, LOST)}, []),
    ],
)
def test_what_is_no_number_is_found(given, names):
    assert list(unmarked_nonfinite_fields(KIND, Sample(STAMP, **given))) == names


def test_what_a_device_of_ours_does_not_report_is_no_hole():
    fields = dict.fromkeys(AdhesionSample.__dataclass_fields__, math.nan)
    sample = AdhesionSample(**{**fields, "stamp": STAMP, "status": OK})
    assert not list(unmarked_nonfinite_fields(kinds()["adhesion"], sample))


def test_the_contract_suite_fails_a_hole_in_a_tuple(monkeypatch):
    monkeypatch.setattr(interface_promises, "kinds", lambda: {"thing": KIND})
    samples = [Sample(STAMP), Sample(STAMP, pair=(1.0, math.nan))]
    watched = SimpleNamespace(samples=samples)
    subject = SimpleNamespace(kind="thing", watched=watched, not_measured=())
    with pytest.raises(Broken, match="pair is NaN or infinite with status ok"):
        interface_promises.no_data_is_no_number(subject)
    subject.watched.samples.pop()
    assert interface_promises.no_data_is_no_number(subject) == "1 samples"


def test_a_run_reports_each_field_once_and_only_of_devices_that_packages_bring():
    imu = kinds()["imu"].sample
    nan = np.full(4, np.nan)
    sample = imu(STAMP, nan, nan[:3], nan[:3], np.ones(3), (3, 3, 3, 3), OK)
    for brought, reported in (
        ({}, []),
        ({"imu": ("quaternion_wxyz", "linear_acceleration_m_s2")}, ["gyro_rad_s"]),
        ({"imu": ()}, ["quaternion_wxyz", "gyro_rad_s", "linear_acceleration_m_s2"]),
    ):
        watch, events = SensorStatus({}, brought=brought), []
        for k in range(3):
            watch.judge(Inputs(k, k * 10_000_000, imu=(sample,)), events)
        assert [(event.source, event.message.split()[4]) for event in events] == [
            ("imu", n) for n in reported
        ]
