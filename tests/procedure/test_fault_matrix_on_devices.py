"""`hil faults --inject-real`: cells of devices that are served at the wire and count as real."""

from __future__ import annotations

import json

import pytest

from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import FaultNotSupportedError, UsageError
from hil.fault_matrix.on_devices import faults_at_links
from hil.faults import permission
from tests.patience import PATIENT
from tests.served_as_real import served_as_real

REAL = {"imu.backend": "real", "imu.port": "/dev/no-such-port"}


def test_what_the_bench_file_permits_is_what_the_wire_can_do():
    permitted = {**REAL, "faults.real": "floor", "faults.devices": ["imu", "servos"]}
    found = faults_at_links(load_bench("emulated_floor", overrides=permitted))
    assert found == {"imu": permission.BY_WIRE["bus"]}


@pytest.mark.parametrize(
    ("profile", "overrides", "error"),
    [
        ("emulated_floor", {}, UsageError),
        ("emulated_floor", REAL, FaultNotSupportedError),
        ("emulated_floor", {**REAL, "faults.devices": ["imu"]}, FaultNotSupportedError),
        ("emulated", {**REAL, "faults.devices": ["imu"], "faults.real": "wall"}, UsageError),
    ],
    ids=["nothing is real", "nothing is named", "nowhere", "on a wall without a tether"],
)
def test_no_cell_where_a_consent_or_a_tether_is_missing(profile, overrides, error):
    with pytest.raises(error):
        faults_at_links(load_bench(profile, overrides=overrides))


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.opens_stand_ins
def test_served_devices_that_count_as_real_are_judged_cell_by_cell(tmp_path, capfd):
    with served_as_real(tmp_path, tables=PATIENT) as bench:
        asked = ["--bench", str(bench), "--inject-real", "--out", str(tmp_path / "out"), "--json"]
        only = ["imu:silent@second", "servos:silent@motion", "mocap:drop@second"]
        code = main(["faults", *asked, *(part for one in only for part in ("--only", one))])
    out = json.loads(capfd.readouterr().out)
    assert (code, out["cells"], out["failed"]) == (0, 3, [])
    rows = [json.loads(row) for row in (tmp_path / "out" / "cells.jsonl").read_text().splitlines()[1:]]
    servos = next(row for row in rows if row["cell"]["device"] == "servos")
    assert servos["ended"] == "stale_servos"
    assert servos["held"] == "not needed"
    assert all(row["cell"]["plant"] == "real" for row in rows)
