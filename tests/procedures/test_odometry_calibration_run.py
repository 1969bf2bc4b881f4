"""Odometry calibration from end to end: rounds, result, report, installing, faults, seeds."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from procedure_runs import options_of, run, watched

from hil.bench.loop_settings import nominal_of
from hil.calibration.calibrate import calibrate
from hil.calibration.calibration_file import read_calibration
from hil.calibration.evaluation import position_rmse, track_all
from hil.calibration.problem import make_setting
from hil.calibration.versions import CalibrationVersions
from hil.core.clock import MonotonicClock
from hil.core.errors import ConfigError
from hil.datasets.plain_csv import read_plain
from hil.procedure import BenchSource
from hil.procedure.procedure_lookup import load_procedure
from hil.procedure.runner import dry_run, run_procedure
from hil.procedures.odometry_calibration import Parameters
from hil.procedures.odometry_calibration.rounds import (
    WORTH,
    Driven,
    Foreseen,
    foresee,
    held_out_together,
    improvement_bound,
    rise_beyond_chance,
)
from hil.report.run_page import write_run_page

SMALL = {
    "motions": "line_x,line_y,rotation_ccw",
    "repetitions": 2,
    "validation_repetitions": 1,
    "line_m": 0.35,
    "turns": 0.15,
    "max_rounds": 2,
    "compared_methods": "interior-point",
    "processes": 1,
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration")
    return run("odometry_calibration", folder / "run", {**SMALL, "install": str(folder / "calibration.toml")})


def test_what_was_found_drives_better_and_passes(small):
    assert small.result.verdict.value in ("PASS", "MARGINAL"), small.result.measurements
    assert small.values["improvement"] > 3.0
    assert small.values["position_rmse_after"] < 2.0
    assert small.values["rejected_share"] == small.values["rejected_recordings"] / 6
    small.assert_held()


def test_turns_on_a_wall_are_refused_before_anything_is_opened(tmp_path):
    used = watched("odometry_calibration", bench="emulated")
    reported = r"circle_ccw, rotation_cw turn the robot by 180 deg.* at most 15 deg"
    procedure = load_procedure("odometry_calibration")
    settings = procedure.settings({}, quick=True)
    with pytest.raises(ConfigError, match=reported):
        dry_run(procedure, used, settings)
    result = run_procedure(procedure, used, options_of(tmp_path / "run", settings))
    assert (result.error.kind, result.exit_code) == ("ConfigError", 2), result.error
    assert not used.benches


def test_turns_that_a_wall_allows_are_planned_there():
    settings = {"motions": "line_x,rotation_ccw,rotation_cw", "turns": 0.03, "line_m": 0.35}
    plan = dry_run(load_procedure("odometry_calibration"), BenchSource("emulated"), settings)
    assert plan["trajectories_checked"] == 3


def test_every_recording_of_every_round_is_there_and_readable(small):
    folder = small.result.folder / "recordings"
    for name, count in (("round_1", 6), ("round_2", 6), ("validation", 3)):
        files = sorted((folder / name).glob("*.csv"))
        assert len(files) == count
        for path in files:
            recording = read_plain(path)
            assert np.isfinite(recording.truth_pose).all()
            assert recording.t_s[-1] > 3.0


def test_the_result_is_kept_with_its_validation_and_installed(small):
    kept = read_calibration(small.result.folder / "calibration.toml")
    assert kept.verdict == small.result.verdict.value
    assert kept.validation["fresh_run"]["mean"]["rmse_position_m"] == pytest.approx(
        1e-3 * small.values["position_rmse_after"]
    )
    assert kept.made_for.drive_ids == (1, 2, 3, 4)
    versions = CalibrationVersions(small.result.folder.parent / "calibration.toml")
    assert [(v.file.version, v.in_place) for v in versions.versions()] == [(1, True)]
    assert versions.versions()[0].file.parameters == kept.parameters


def test_the_report_holds_the_papers_tables_and_what_was_driven(small):
    tree = json.loads((small.result.folder / "result.json").read_text())
    table = {t["title"][:9].strip(": "): t for t in tree["tables"]}
    assert len(table["Table I"]["rows"]) == 16
    assert [r[0] for r in table["Table II"]["rows"]] == ["line x", "line y", "rotation ccw"]
    page = write_run_page(small.result.folder).read_text()
    assert page.count("data:image/svg+xml;base64,") == 3


def test_a_round_is_driven_with_what_the_round_before_found(small):
    first, second = small.source.benches[0], small.source.benches[4]  # two worlds a repetition
    assert first.calibration == ""
    assert second.calibration == "calibration_round_1.toml version 1"
    assert not np.array_equal(first.geometry.vector(), second.geometry.vector())


TINY = {
    "motions": "line_x,line_y,circle_ccw",
    "repetitions": 2,
    "validation_repetitions": 1,
    "line_m": 0.5,
    "radius_m": 0.3,
    "turns": 0.2,
    "max_rounds": 2,
    "compared_methods": "",
    "processes": 1,
}


@pytest.mark.long
def test_a_bad_result_is_not_installed(tmp_path):
    target = tmp_path / "calibration.toml"
    parameters = {**TINY, "motions": "circle_ccw", "turns": 0.15, "install": str(target)}
    done = run("odometry_calibration", tmp_path / "run", parameters, faults=("servos:delayed,delay_s=0.15",))
    assert done.result.verdict.value == "FAIL"
    assert not target.exists()
    assert [v.file.verdict for v in CalibrationVersions(target).versions()] == ["FAIL"]
    assert any("was left as it is" in n for n in done.result.facts["notes"])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("mocap:off", "no server answers"),
        ("mocap:stuck@2", "no usable frame"),
        ("mocap:garbage@2", "no usable frame"),
        ("servo.drive_FL:stuck@2", "FL"),
        ("servos:off@3", "servo"),
    ],
)
def test_it_fails_under_a_fault_that_makes_it_impossible(tmp_path, fault, words):
    done = run("odometry_calibration", tmp_path / "run", TINY, faults=(fault,))
    assert (done.result.verdict.value, done.result.exit_code) == ("ERROR", 3)
    assert words in done.result.error.message
    assert not (tmp_path / "run" / "calibration.toml").exists()


@pytest.mark.long
def test_two_processes_record_the_same_bytes_as_one(tmp_path):
    parameters = {**TINY, "motions": "line_x", "line_m": 0.2, "max_rounds": 1, "min_rounds": 1}
    for processes in (1, 2):
        used = watched("odometry_calibration") if processes == 1 else BenchSource("emulated_floor")
        options = options_of(tmp_path / str(processes), {**parameters, "processes": processes})
        run_procedure(load_procedure("odometry_calibration"), used, options)
    first = {p.name: p.read_bytes() for p in (tmp_path / "1" / "recordings").rglob("*.csv")}
    second = {p.name: p.read_bytes() for p in (tmp_path / "2" / "recordings").rglob("*.csv")}
    assert first == second
    assert len(first) == 3
    results = [json.loads((tmp_path / n / "result.json").read_text()) for n in ("1", "2")]
    assert results[0]["measurements"] == results[1]["measurements"]
    assert results[0]["verdict"] == results[1]["verdict"] == "MARGINAL"
    assert results[0]["held"]["state"] == results[1]["held"]["state"] == "not needed"
    assert "NOT MEASURED" not in {m["outcome"] for m in results[0]["measurements"]}
    assert all(m["value"] is not None for m in results[0]["measurements"])
    assert not (tmp_path / "1" / "calibration.toml").exists()


def test_more_rounds_than_allowed_are_refused():
    with pytest.raises(ValueError, match="min_rounds = 3 exceeds max_rounds = 2"):
        Parameters(min_rounds=3, max_rounds=2)


def test_a_forward_model_is_judged_on_motions_and_then_on_rounds_that_its_fit_has_not_seen():
    def driven(label, *motions):
        return Driven(label, [SimpleNamespace(motion=m) for m in motions], None)

    first = driven("round 1", "line_x", "line_x", "line_y", "circle_cw")
    assert held_out_together([first]) == ("motions", ["line_x", "line_x", "line_y", "circle_cw"])
    assert held_out_together([driven("round 1", "line_x", "line_x", "line_y")]) == ("repetitions", [])
    second = driven("round 2", "line_x")
    assert held_out_together([first, second]) == ("rounds", ["round 1"] * 4 + ["round 2"])


def test_the_stop_rule_wants_more_than_chance():
    rng = np.random.default_rng(3)
    before = rng.uniform(5.0, 50.0, 30)
    assert improvement_bound(before, 0.5 * before, rng) == pytest.approx(0.5)
    assert improvement_bound(before, before, rng) == 0.0
    noise = before * (1.0 + 0.2 * rng.standard_normal(30))
    assert improvement_bound(before, noise, rng) < 0.05
    assert improvement_bound(before, 2.0 * before, rng) == pytest.approx(-1.0)


def test_another_round_is_worth_it_only_where_knowing_the_newest_one_helps():
    rng = np.random.default_rng(5)
    without = rng.uniform(2e-3, 4e-3, 30)
    assert Foreseen(without, 0.7 * without).gain(0) == pytest.approx(0.3)
    assert Foreseen(without, without).gain(0) == 0.0
    assert Foreseen(without, without * (1.0 + 0.1 * rng.standard_normal(30))).gain(0) < WORTH


def driven_small(small, number):
    """A round of the small run, as the procedure has it."""
    folder = small.result.folder / "recordings" / f"round_{number}"
    names = [f"{m}_{2 * number - 1 + k}.csv" for k in range(2) for m in ("line_x", "line_y", "rotation_ccw")]
    return Driven(f"round {number}", [read_plain(folder / name) for name in names], None)


def test_the_newest_round_is_read_by_fits_that_have_not_seen_it(small):
    rounds = [driven_small(small, 1), driven_small(small, 2)]
    recordings = [r for d in rounds for r in d.recordings]
    nominal = nominal_of(small.source.config)
    setting = make_setting("recommended", model="creep")

    def fitted(kept):
        return calibrate(kept, setting, MonotonicClock(), nominal=nominal, validate=False)

    foreseen = foresee(rounds, fitted(recordings))
    assert foreseen.without_round.shape == foreseen.without_repetition.shape == (6,)
    assert foreseen.without_round.mean() > foreseen.without_repetition.mean()
    for read, kept in (
        (foreseen.without_round, rounds[0].recordings),
        (foreseen.without_repetition, recordings[:9]),
    ):
        result = fitted(kept)
        runs = track_all(rounds[1].recordings[3:], result.geometry, result.setting.model)
        assert read[3:] == pytest.approx([position_rmse(run) for run in runs], abs=2e-4)


def test_a_rise_counts_only_as_far_as_chance_does_not_explain_it():
    rng = np.random.default_rng(4)
    earlier = rng.uniform(2e-3, 4e-3, 30)
    assert rise_beyond_chance(earlier, earlier + 1e-3, rng) == pytest.approx(1e-3)
    assert rise_beyond_chance(earlier, earlier - 1e-3, rng) == 0.0
    assert rise_beyond_chance(earlier, rng.permutation(earlier), rng) == 0.0
    noisy = rise_beyond_chance(earlier, earlier + 1e-3 + 1e-3 * rng.standard_normal(30), rng)
    assert 0.0 < noisy < 1e-3


def calibrated(folder, seed, parameters):
    """Run the procedure in a world; returns its measurements and how far parameters are from the truth.

    The latter (16,) in standard errors, as the calibration that it wrote states them.
    """
    source = BenchSource("emulated_floor", seed=seed)
    options = options_of(folder, {"compared_methods": "", **parameters})
    result = run_procedure(load_procedure("odometry_calibration"), source, options)
    assert result.verdict.value in ("PASS", "MARGINAL"), (seed, result.measurements)
    file = read_calibration(folder / "calibration.toml")
    with source.open() as bench:
        truth = bench.world.plant.parameters.geometry().vector()
    std = np.concatenate([file.std[k] for k in ("x_w_m", "y_w_m", "r_m", "delta0_rad")])
    found = {m["name"]: m["value"] for m in result.measurements}
    return found, (file.geometry.vector() - truth) / std


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_over_ten_seeds_of_hidden_truth_the_error_falls_eightfold(tmp_path):
    """Full motions and repetitions. A robot that hardly errs before cannot improve eightfold."""
    found = [calibrated(tmp_path / str(seed), seed, {})[0] for seed in range(10)]
    before, after = (np.array([f[f"position_rmse_{k}"] for f in found]) for k in ("before", "after"))
    assert after.max() <= 4.0, after
    assert before.mean() / after.mean() >= 8.0
    wrong = before >= 30.0
    assert wrong.any()
    assert (before[wrong] / after[wrong]).min() >= 8.0


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_over_twenty_seeds_the_injected_geometry_lies_within_the_stated_errors(tmp_path):
    """Wheel positions, radii and zeros against the truth that drove the plant: z scores are standard."""
    brief = {"repetitions": 2, "validation_repetitions": 1, "max_rounds": 2}
    scores = np.array([calibrated(tmp_path / str(seed), seed, brief)[1] for seed in range(20)])
    assert np.sqrt(np.mean(scores**2)) < 1.3
    assert np.mean(np.abs(scores) < 2.0) >= 0.88
