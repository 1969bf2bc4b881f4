"""Recordings that another arithmetic has made: they agree within limits, and each limit bites."""

import json
import os
import platform
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from mcap_cases import driving_record

import hil
from hil.cli import main
from hil.core.interfaces import Sink
from hil.core.signals import Event
from hil.recording.mcap_writer import McapRecorder
from hil.replay.difference_limits import LIMITS, Agreement, same_text
from hil.replay.verification import DECIDED
from hil.robot.trajectories import line
from hil.support.arithmetic_fingerprint import fingerprint

pytestmark = pytest.mark.timeout(600)  # the first process to start may compile the estimators

WAY = line((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), duration_s=1.0)
ELSEWHERE = {**fingerprint(), "blas": "openblas 0.3.31 ARMV8", "machine": "aarch64"}


def decided(record):
    return {name: getattr(record, name) for name in DECIDED}


def of_state(**changes):
    return lambda record: replace(record, state=replace(record.state, **changes))


def of_state_plus(field, index, off):
    def change(record):
        values = getattr(record.state, field).copy()
        values[index] += off
        return replace(record, state=replace(record.state, **{field: values}))

    return change


def of_diagnostics(name, value):
    return lambda record: replace(
        record, state=replace(record.state, diagnostics={**record.state.diagnostics, name: value})
    )


def of_part(part, field, off):
    def change(record):
        inner = getattr(record, part)
        return replace(record, **{part: replace(inner, **{field: getattr(inner, field) + off})})

    return change


def of_gyro(off):
    def change(record):
        (gyro,) = record.measurements.gyro
        gyro = replace(gyro, yaw_rate_rad_s=gyro.yaw_rate_rad_s + off)
        return replace(record, measurements=replace(record.measurements, gyro=(gyro,)))

    return change


RECORD = of_diagnostics("gyro_bias_rad_s", 0.01)(driving_record(3))
DISTURBED = {
    "position_m": lambda off: of_state_plus("pose_body_in_wall", 1, off),
    "heading_rad": lambda off: of_state_plus("pose_body_in_wall", 2, off),
    "velocity_m_s": lambda off: of_state_plus("twist_body", 0, off),
    "yaw_rate_rad_s": lambda off: of_state_plus("twist_body", 2, off),
    "gyro_bias_rad_s": lambda off: of_diagnostics("gyro_bias_rad_s", 0.01 + off),
    "covariance": lambda off: of_state_plus("covariance", (2, 4), off * 1e-4),  # sigma^2 is 1e-4
    "diagnostics": lambda off: of_diagnostics(
        "nis_wheels", RECORD.state.diagnostics["nis_wheels"] * (1.0 + off)
    ),
    "measurements": of_gyro,
    "reference": lambda off: of_part("reference", "pose_in_wall", off),
    "wheel_rate_rad_s": lambda off: of_part("command", "drive_velocity_rad_s", off),
    "steering_rad": lambda off: of_part("setpoint", "steering_rad", off),
}
"""What a quantity looks like that is off by so much, in the unit of its limit."""


def test_every_limit_is_tried():
    assert set(DISTURBED) == set(LIMITS)


@pytest.mark.parametrize("quantity", LIMITS)
def test_each_limit_bites(quantity):
    limit = LIMITS[quantity].value
    within, beyond = Agreement(), Agreement()
    assert within.take(decided(RECORD), decided(DISTURBED[quantity](0.8 * limit)(RECORD))) is None
    assert within.largest[quantity] == pytest.approx(0.8 * limit, rel=1e-3)
    assert all(value == 0.0 for name, value in within.largest.items() if name != quantity)
    found = beyond.take(decided(RECORD), decided(DISTURBED[quantity](1.25 * limit)(RECORD)))
    assert f"{limit:g}" in found
    assert beyond.largest[quantity] == pytest.approx(1.25 * limit, rel=1e-3)


def test_observers_have_the_limits_of_the_state():
    record = replace(RECORD, observers={"ukf": RECORD.state})
    for factor, agrees in ((0.8, True), (1.25, False)):
        off = of_state_plus("pose_body_in_wall", 0, factor * LIMITS["position_m"].value)(record).state
        found = Agreement().take(decided(record), decided(replace(record, observers={"ukf": off})))
        assert (found is None) == agrees
        assert agrees or found.startswith("observers.ukf.pose_body_in_wall[0]: ")


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("state.diagnostics.rejected_wheels", of_diagnostics("rejected_wheels", 20_001.0)),
        ("state.diagnostics.nis_wheels", of_diagnostics("nis_wheels", float("nan"))),
        ("state.diagnostics", of_diagnostics("one_more", 0.0)),
        ("state.pose_body_in_wall[1]", of_state_plus("pose_body_in_wall", 1, np.nan)),
        ("state.t_ns", of_state(t_ns=RECORD.state.t_ns + 1)),
        ("events", lambda r: replace(r, events=())),
        ("events.0.level", lambda r: replace(r, events=(replace(r.events[0], level="error"),))),
        ("reference", lambda r: replace(r, reference=None)),
        ("measurements.tracker", lambda r: replace(r, measurements=replace(r.measurements, tracker=()))),
    ],
)
def test_what_is_no_rounding_differs_whatever_its_size(field, change):
    record = of_diagnostics("rejected_wheels", 20_000.0)(RECORD)
    agreement = Agreement()
    found = agreement.take(decided(record), decided(change(record)))
    assert found.startswith(field)
    unknown = "nan" in found
    assert (agreement.flip is None) == unknown


def test_a_flag_differs():
    (wheels,) = RECORD.measurements.wheels
    other = replace(wheels, valid=(True, True, False, True))
    changed = replace(RECORD, measurements=replace(RECORD.measurements, wheels=(other,)))
    assert Agreement().take(decided(RECORD), decided(changed)).startswith("measurements.wheels.0.valid.2: ")


def test_nothing_is_known_where_nothing_was_measured():
    unknown = of_diagnostics("nis_wheels", float("nan"))(of_state_plus("twist_body", 0, np.nan)(RECORD))
    assert Agreement().take(decided(unknown), decided(unknown)) is None


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("stale for 0.52 s", "stale for 0.51 s", True),
        ("off by 0.100 m", "off by 0.099 m", True),
        ("stale for 0.53 s", "stale for 0.51 s", False),
        ("3 samples refused", "4 samples refused", False),
        ("imu: off by 0.5 m", "tracker: off by 0.5 m", False),
        ("off by 0.50 m", "off by 0.5 m", False),
    ],
)
def test_messages_may_differ_in_the_last_digit_of_a_decimal(one, other, same):
    assert same_text(one, other) == same
    record = replace(RECORD, events=(Event(0, "warning", "imu", one),))
    changed = replace(RECORD, events=(Event(0, "warning", "imu", other),))
    assert (Agreement().take(decided(record), decided(changed)) is None) == same


class Kept(Sink):
    """Keeps what a recorder is given."""

    def __init__(self):
        self.given = []

    def write(self, record):
        self.given.append((record,))

    def note(self, t_ns, kind, data):
        self.given.append((t_ns, kind, data))

    def close(self):
        pass


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """A function that records a short drive as another computer would have decided it."""
    bench, kept = hil.open_bench("emulated", seed=4), Kept()
    header = bench.header()
    bench.add_sink(kept)
    with bench:
        bench.drive(WAY, hold_s=0.1)

    def go(arithmetic, off_m, change=None):
        path = tmp_path_factory.mktemp("drive") / "drive.mcap"
        recorder = McapRecorder(path, {**header, "arithmetic": arithmetic}, lossless=True)
        change = change or of_state_plus("pose_body_in_wall", 0, off_m)
        for given in kept.given:
            if len(given) == 1:
                recorder.write(change(*given))
            else:
                recorder.note(*given)
        recorder.close()
        return path

    return go


def replay(capsys, *words):
    code = main(["replay", *map(str, words), "--verify", "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_bits_are_demanded_of_the_same_arithmetic_and_limits_of_another(record, capsys, tmp_path):
    here = fingerprint()
    code, found = replay(capsys, record(here, 0.0))
    assert (code, found["verdict"], found["recorded_with"]) == (0, "identical", here)
    code, found = replay(capsys, record(here, 1e-9))
    assert (code, found["verdict"]) == (1, "differs")
    assert "every bit" in found["runs"][0]["remark"]
    code, found = replay(capsys, record(ELSEWHERE, 0.0))
    assert (code, found["verdict"], found["largest"]) == (0, "identical", {})
    page = tmp_path / "page.html"
    code, found = replay(capsys, record(ELSEWHERE, 1e-9), "--page", page)
    assert (code, found["verdict"], found["recorded_with"]) == (0, "agrees", ELSEWHERE)
    assert found["verified_with"] == here
    assert found["largest"]["position_m"] == pytest.approx(1e-9, rel=1e-3)
    assert [run["difference"] for run in found["runs"]] == [None, None]
    shown = page.read_text(encoding="utf-8")
    assert all(text in shown for text in ("position_m", "ARMV8", here["blas"]))


def test_beyond_a_limit_it_differs_with_the_first_cycle_and_field(record, capsys):
    path = record(ELSEWHERE, 1e-5)
    code, found = replay(capsys, path)
    assert (code, found["verdict"]) == (1, "differs")
    first = found["runs"][0]
    assert first["verdict"] == "differs"
    assert first["difference"].startswith("cycle 0: state.pose_body_in_wall[0]: ")
    assert found["largest"]["position_m"] == pytest.approx(1e-5, rel=1e-3)
    assert "remark" not in first


@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="OpenBLAS kernel not known")
def test_another_kernel_of_the_matrix_library_is_another_arithmetic(record):
    """A real one: OpenBLAS can be asked to compute as an older processor would."""
    kernels = {"x86_64": ("Prescott", "Nehalem"), "aarch64": ("CORTEXA53", "NEOVERSEN1")}[platform.machine()]
    kernel = kernels[os.environ.get("OPENBLAS_CORETYPE") == kernels[0]]
    done = subprocess.run(
        [sys.executable, "-m", "hil", "replay", record(fingerprint(), 0.0), "--verify", "--json"],
        env={**os.environ, "OPENBLAS_CORETYPE": kernel},
        stdout=subprocess.PIPE,
        check=False,
    )
    found = json.loads(done.stdout)
    assert done.returncode == 0
    assert found["verdict"] in ("agrees", "identical")
    assert found["verified_with"] != found["recorded_with"]


def test_a_sample_on_the_other_side_of_its_threshold_is_remarked_upon(record, capsys):
    """A recorded count that the replay does not reach."""
    off = of_diagnostics("rejected_gyro", 9.0)
    path = record(ELSEWHERE, 0.0, lambda r: off(r) if "rejected_gyro" in r.state.diagnostics else r)
    code, found = replay(capsys, path)
    assert (code, found["verdict"]) == (1, "differs")
    (remark,) = [run["remark"] for run in found["runs"] if "remark" in run]
    assert "rejected_gyro: was 9.0, now 0.0" in remark
    assert main(["replay", str(path), "--verify"]) == 1
    assert remark in capsys.readouterr().out


@pytest.mark.parametrize("arithmetic", ["fast", {"blas": 3}])
def test_a_header_that_names_no_arithmetic_is_refused(record, capsys, arithmetic):
    assert main(["replay", str(record(arithmetic, 0.0)), "--verify"]) == 2
    assert "has a header whose `arithmetic` cannot be used" in capsys.readouterr().err
