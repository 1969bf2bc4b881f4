"""`hil faults --configuration`: a wrong number in the bench file is named, and what is true decides."""

import json

import pytest

from hil.bench.true_values import true_bench
from hil.cli import main
from hil.config.assumed_parameters import parameters_of
from hil.config.loading import load_bench
from hil.fault_matrix.wrong_values.cases import BENCHES, cases_of, right, tables_of
from hil.fault_matrix.wrong_values.judge import judge
from hil.fault_matrix.wrong_values.observed import Observed, Told, Truth, without_mistake


def test_there_are_many_cases_and_each_differs_from_what_is_true():
    cases = cases_of(plants=("own", "mujoco"), seeds=(0,))
    assert len(cases) >= 80
    assert len(set(cases)) == len(cases)
    assert all(case.said != case.true for case in cases)
    assert len({case.key for case in cases_of(plants=("own",), seeds=(0,), quick=True)}) >= 20


def test_every_parameter_of_a_device_has_a_true_value_that_may_differ_from_the_file():
    """The world is built with the true value: it can be the file's own, too, without any change."""
    for bench in BENCHES:
        overrides = right(bench, "own")
        config = load_bench("emulated", overrides=overrides)
        for key, value, _ in parameters_of(tables_of(config)):
            if not key.startswith("alignment."):  # the wheels' true signs are 1, their true zeros are drawn
                truth = {**overrides, f"emulation.{key}": value}
                table, _, name = key.partition(".")
                found = true_bench(load_bench("emulated", overrides=truth))
                assert getattr(getattr(found, table), name) == value, key


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "plant", "noise"), [(41, "own", 3.0), (42, "mujoco", 3.0), (43, "own", 0.3)]
)
def test_a_right_bench_is_contradicted_by_no_stage(seed, plant, noise):
    found = without_mistake("", plant, seed, noise)
    assert found.contradicted == {}
    assert not found.doctor.refused, found.doctor.texts
    assert not found.climb.refused, found.climb.texts


def test_one_key_is_run_and_judged(tmp_path, capsys):
    asked = ["faults", "--configuration", "--quick", "--only", "adhesion.pole_pairs"]
    assert main([*asked, "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cases"], found["right"], found["silent"]) == (1, 1, [])
    assert "adhesion.pole_pairs" in (tmp_path / "wrong_values.md").read_text()


@pytest.mark.parametrize("more", [["--only", "robot.mas_kg"], ["--random", "3"], ["--resume"]])
def test_what_has_no_meaning_is_refused(tmp_path, more):
    assert main(["faults", "--configuration", *more, "--out", str(tmp_path)]) == 2


(CASE,) = (c for c in cases_of(plants=("own",), seeds=(0,), quick=True) if c.key == "robot.mass_kg")
USUAL = Observed(truth=Truth(drove=True, adhesion_n=45.0, thrust_n=22.0))
WEAK = Truth(drove=True, adhesion_n=45.0, thrust_n=13.0)
SAYS, OTHER = Told(["robot.mass_kg is wrong"], refused=True), Told(["the camera is wrong"], refused=True)


@pytest.mark.parametrize(
    ("seen", "outcome"),
    [
        (Observed(climb=SAYS, truth=WEAK), "right"),
        (Observed(climb=OTHER, truth=WEAK), "misnamed"),
        (Observed(truth=USUAL.truth), "harmless"),
        (Observed(truth=WEAK, parameters={"robot.mass_kg": {"state": "unconfirmed"}}), "unconfirmed"),
        (Observed(truth=WEAK, parameters={"robot.mass_kg": {"state": "confirmed"}}), "silent"),
        (Observed(truth=WEAK), "silent"),
        (Observed(climb=Told(["robot.mass_kg may be wrong"]), truth=WEAK), "silent"),
    ],
)
def test_an_effect_that_nobody_stops_is_silent(seen, outcome):
    assert judge(CASE, seen, USUAL).outcome == outcome
