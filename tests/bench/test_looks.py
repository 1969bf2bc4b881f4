"""What the doctor says of samples that no emulated device sends by itself: looks, on samples made here."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.bench.device_set_from_config import model_of
from hil.bench.third_party.sample_contract import find_contract_breaks
from hil.config.load_cells import LineCellsConfig
from hil.config.loading import load_bench
from hil.core.registry import kinds
from hil.core.signals import AdhesionSample, Status
from hil.drivers.doctor_watch import Watched, losses
from tests.recording.mcap_cases import driving_record

INPUTS = driving_record(0).inputs


class Clock:
    """Stands at a second; sleeping takes none."""

    def now_ns(self):
        return 1_000_000_000

    def sleep_until_ns(self, t_ns):
        """At once."""


def watched(name, samples, device=None, table=None):
    config = load_bench("emulated")
    table = config.devices().get(name) if table is None else table
    return Watched(kinds()[name], table, device, tuple(samples), 1.0, Clock(), 100.0)


def wrong(findings):
    return {f.check: f for f in findings if f.level != "ok"}


def look(name, samples, device=None, table=None):
    return wrong(kinds()[name].check(watched(name, samples, device, table)))


def cells(force_n):
    return replace(INPUTS.load_cells[0], force_n=np.array([force_n, force_n]))


@pytest.mark.parametrize(
    ("name", "samples", "check"),
    [
        ("imu", [replace(INPUTS.imu[0], gravity_m_s2=np.array([0.0, 0.0, 4.0]))], "gravity"),
        ("mocap", [replace(INPUTS.mocap[0], latency_s=0.2)], "latency"),
        ("tracker", [replace(INPUTS.tracker[0], confidence=1)], "confidence"),
        ("load_cells", [cells(10.0), cells(40.0)], "noise"),
    ],
)
def test_what_is_wrong_with_samples_is_reported_with_a_remedy(name, samples, check):
    table = LineCellsConfig(backend="emulated", port="hil://x") if name == "load_cells" else None
    assert look(name, samples, table=table)[check].remedy


def test_a_camera_of_other_firmware_is_reported():
    device = SimpleNamespace(identity=lambda: {"firmware": "0.2.0.100"})
    found = wrong(model_of(load_bench("emulated"), "tracker").check(watched("tracker", [], device)))
    assert 'tracker.firmware = ["0.2.0.100"]' in found["firmware"].remedy


def test_hot_servos_are_reported():
    health = replace(driving_record(0).inputs.health[0], temperature_c=np.full(8, 85.0))
    servos = SimpleNamespace(
        read=lambda: (), read_health=lambda: (health,), model=SimpleNamespace(low_supply_v=11.0)
    )
    assert look("servos", INPUTS.servos, servos)["temperature"].remedy


@pytest.mark.parametrize(("fet_c", "level"), [(150.0, "failure"), (np.nan, "warning")])
def test_a_hot_fan_and_one_that_does_not_report_are_reported(fet_c, level):
    stamp = INPUTS.imu[0].stamp
    sample = AdhesionSample(stamp, 20_000.0, 0.5, 10.0, 5.0, 24.0, fet_c, 30.0)
    table = kinds()["adhesion"].model("vesc").config(backend="emulated")
    found = look("adhesion", [sample], table=table)["power stage"]
    assert found.level == level


def test_a_package_that_breaks_its_promises_is_reported_each_with_what_to_do():
    first = INPUTS.tracker[0]
    late = replace(first.stamp, t_ns=10**12, host_ns=10**12 - 10**9)
    bad = replace(first, stamp=late, position_m=np.full(3, np.nan))
    found = wrong(find_contract_breaks(watched("tracker", [bad]), [0.02, 0.02]))
    assert {name: bool(f.remedy) for name, f in found.items()} == dict.fromkeys(
        ("numbers", "stamps", "reads"), True
    )


@pytest.mark.parametrize(
    ("good", "starting", "level"), [(99, 0, "ok"), (90, 9, "warning"), (75, 0, "failure")]
)
def test_samples_that_are_missing_are_a_warning_or_a_failure_by_their_share(good, starting, level):
    statuses = [Status.STARTING] * starting + [Status.OK] * good
    found = losses("imu", statuses, 100, "check wiring")
    assert (found.level, found.found) == (level, f"{good} of 100 good (no bad samples)")
    assert losses("imu", [], 0, "check wiring").level == "failure"


def test_samples_that_repeat_themselves_are_not_put_down_to_the_wiring():
    stuck = losses("imu", [Status.FROZEN] * 100, 100, "check wiring")
    assert "wiring" not in stuck.remedy
    assert "repeat" in stuck.remedy
    some_lost = losses("imu", [Status.OK] * 40 + [Status.FROZEN] * 10, 100, "check wiring")
    assert some_lost.remedy == "check wiring"


@pytest.mark.parametrize(
    ("good", "bad", "level"), [(106, 0, "ok"), (108, 0, "warning"), (100, 100, "failure")]
)
def test_more_samples_than_the_rate_allows_are_not_ok(good, bad, level):
    statuses = [Status.OK] * good + [Status.CRC] * bad
    assert losses("imu", statuses, 100, "check wiring").level == level
