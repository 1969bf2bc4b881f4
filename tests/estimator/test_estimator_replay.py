"""`hil replay` on an emulated wall recording: odometry, EKF, UKF and smoother in one table and one page."""

import json

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.core.errors import DataError
from hil.loop.driven_motion import Motion
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.robot.trajectories import line


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A short line across the wall, recorded by the bench in virtual time."""
    path = tmp_path_factory.mktemp("wall") / "line.mcap"
    with hil.open_bench("emulated", seed=3) as bench:
        bench.devices.actuators().enable()
        start = bench.settle(0.5)
        bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
        bench.drive(
            line(start, start + np.array([0.0, 0.2, 0.0]), duration_s=6.0), start_pose=start, hold_s=0.5
        )
    return path


def test_the_table_holds_all_four_and_the_filters_beat_odometry(recording, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["replay", str(recording), "--json", "--page", str(page)]) == 0
    table = json.loads(capsys.readouterr().out)["estimators"]
    assert list(table) == ["recorded", "odometry", "ekf", "ukf", "smoother"]
    assert table["ekf"]["rmse_position_m"] == table["recorded"]["rmse_position_m"]
    for name in ("ekf", "ukf", "smoother"):
        assert table[name]["rmse_position_m"] < 0.5 * table["odometry"]["rmse_position_m"]
        assert table[name]["rmse_theta_rad"] < 0.5 * table["odometry"]["rmse_theta_rad"]
        assert table[name]["nees_pose"] < 6.0
    assert table["odometry"]["nees_pose"] < 30.0, "what the wheels cannot see is in its covariance"
    assert table["ekf"]["nis_tracker"] > 0.0
    assert abs(table["ekf"]["lag1_gyro"]) < 1.0
    assert table["odometry"]["nis_tracker"] is None
    assert "smoother" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "ending"),
    [
        (("export", "{}", "--out", "{}"), ".csv"),
        (("replay", "{}", "--estimator", "odometry", "--page", "{}"), ".html"),
        (("tune", "{}", "--evaluations", "2", "--out", "{}"), ".toml"),
    ],
)
def test_a_recording_is_not_written_over_by_what_is_made_of_it(recording, words, ending, capsys):
    before = recording.read_bytes()
    assert main([word.format(recording) for word in words]) == 2
    assert f"expected one that ends with {ending}" in capsys.readouterr().err
    assert recording.read_bytes() == before


def test_what_is_left_of_a_damaged_recording_is_fitted_and_the_damage_named(recording, tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: 3 * recording.stat().st_size // 5])
    assert main(["tune", str(cut), "--evaluations", "2", "--json"]) == 2
    out, err = capsys.readouterr()
    reported = json.loads(out)
    assert str(cut) in reported["problems"][0]
    assert f"warning: {reported['problems'][0]}; what was readable is used" in err
    assert reported["fitted"]["after"]["rmse_position_m"] > 0.0


@pytest.mark.parametrize("as_json", [True, False])
def test_a_page_that_the_disk_does_not_take_costs_no_figure(
    recording, tmp_path, capsys, monkeypatch, as_json
):
    def full(path, text):
        raise DataError(str(path), "cannot be written (No space left on device)")

    monkeypatch.setattr("hil.report.overview.write_text", full)
    page = tmp_path / "page.html"
    words = ["replay", str(recording), "--estimator", "odometry", "--page", str(page)]
    assert main([*words, *["--json"] * as_json]) == 2
    out, err = capsys.readouterr()
    assert f"hil: {page}: cannot be written (No space left on device)" in err
    if as_json:
        reported = json.loads(out)
        assert reported["estimators"]["odometry"]["rmse_position_m"] > 0.0
        assert reported["error"]["message"].startswith(str(page))
    else:
        assert [row.split()[0] for row in out.splitlines()][:3] == ["estimator", "recorded", "odometry"]


def test_each_sensor_has_the_noise_that_it_has(recording):
    """Mean NIS per row over the whole run, on the profile as shipped, which expects turns in place, too."""
    run = open_recording(recording).run()
    motion = Motion(tuple(run.records))
    for name, rows, least in (("wheels", 8, 0.6), ("gyro", 1, 0.1), ("tracker", 3, 0.7)):
        assert least < np.nanmean(motion.diagnostic(f"nis_{name}")) / rows < 1.4, name
