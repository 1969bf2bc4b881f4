"""`[environment]` says what the robot stands on; keys of version 0.1 are told where they belong now."""

import math

import pytest

import hil
from hil.bench.settings import motion_limits, safety_limits
from hil.config.environment import SURFACES
from hil.config.loading import load_bench, validate
from hil.config.older import lifted, told_where_now
from hil.config.recorded import recorded_bench
from hil.fakes.plant import surfaces
from hil.vocabulary.errors import ConfigError

HEAD = 'schema = 1\nname = "old"\n'


@pytest.fixture
def refused(tmp_path):
    def load(text):
        path = tmp_path / "bench.toml"
        path.write_text(HEAD + text)
        with pytest.raises(ConfigError) as error:
            load_bench(path)
        return error.value.problems

    return load


@pytest.mark.parametrize(("tilt_rad", "on_wall"), [(0.0, False), (0.05, False), (0.3, True), (1.57, True)])
def test_wall_or_floor_follows_from_the_tilt_of_the_emulated_world(tilt_rad, on_wall):
    with hil.open_bench("emulated", overrides={"environment.tilt_rad": tilt_rad}) as bench:
        assert bench.truth().tilt_rad == tilt_rad
        assert safety_limits(bench.config).on_wall is on_wall
        assert bench.alignment_parameters.on_wall is on_wall
        assert (motion_limits(bench.config).heading_limit_rad is not None) is on_wall


def test_a_floor_cannot_be_steep_and_what_cannot_be_emulated_is_named(refused):
    (problem,) = refused('[environment]\nsurface = "floor"\n')
    assert problem.startswith("environment.surface: 'floor' with tilt_rad = 1.5708")
    text = '[environment]\nsurface = "steel"\n[imu]\nbackend = "emulated"\n'
    (problem,) = refused(text)
    assert problem == "environment.surface: 'steel' cannot be emulated, only " + ", ".join(SURFACES)
    assert tuple(surfaces.SURFACES) == SURFACES


def test_a_real_robot_may_stand_on_anything(tmp_path):
    (tmp_path / "b.toml").write_text(HEAD + '[environment]\nsurface = "steel"\n[imu]\n')
    assert load_bench(tmp_path / "b.toml").environment.surface == "steel"


@pytest.mark.parametrize(
    ("text", "key", "where"),
    [
        ('surface = "floor"\n', "surface", "environment.tilt_rad"),
        ('surface = "wall"\n', "surface", "environment.tilt_rad"),
        ('[emulation]\nsurface = "patchy"\n', "emulation.surface", "environment.surface now"),
        ("[emulation]\ntilt_rad = 0.0\n", "emulation.tilt_rad", "environment.tilt_rad now"),
        ("[emulation]\nstart_pose = [1, 2, 0]\n", "emulation.start_pose", "environment.start_pose now"),
        ("[estimator.gates]\ntwo_dof = 9.0\n", "estimator.gates.two_dof", "remove it (found 9.0)"),
        ("[encoders]\nbacklash_limit_rad = 0.02\n", "encoders.backlash_limit_rad", "`steering_zero` judges"),
    ],
)
def test_an_old_key_is_told_where_it_belongs_now(refused, text, key, where):
    (problem,) = refused(text)
    assert problem.startswith(f"{key}: ")
    assert where in problem


def test_old_keys_are_told_beside_everything_else_and_judged_as_they_were_meant(refused):
    problems = refused(
        'surface = "floor"\n[emulation]\nsurface = "floor"\ntilt_rad = 0.0\nwhim = 1\n'
        "[servos]\nwatchdog_s = 0.5\nvelocity_limit_rad_s = inf\n"
    )
    assert [p.partition(":")[0] for p in problems] == [
        "surface", "emulation.surface", "emulation.tilt_rad", "emulation.whim", "servos.velocity_limit_rad_s"
    ]  # fmt: skip


def test_an_override_of_an_old_key_is_refused_too():
    with pytest.raises(ConfigError, match=r"emulation\.surface: it is environment\.surface now"):
        load_bench("emulated", overrides={"emulation.surface": "patchy"})
    assert load_bench("emulated").environment.tilt_rad == math.pi / 2.0


@pytest.mark.parametrize("table", ["safety", "environment"])
def test_the_usable_area_is_read_where_it_belongs_and_where_it_was(table):
    tree = {"schema": 1, "name": "lab", table: {"x_range_m": [-1.0, 2.0]}}
    assert validate(tree, "b").environment.x_range_m == (-1.0, 2.0)


def test_keys_that_are_gone_are_left_out_of_what_was_recorded_and_those_of_other_models_stay():
    tree = {
        "schema": 1, "name": "lab", "estimator": {"gates": {"two_dof": 13.82, "one_dof": 9.0}},
        "encoders": {"backlash_limit_rad": 0.01, "rate_hz": 100.0},
    }  # fmt: skip
    config = recorded_bench(tree, "r.mcap")
    assert config.estimator.gates.one_dof == 9.0
    assert config.encoders.rate_hz == 100.0
    of_another_model = {"encoders": {"model": "mine", "backlash_limit_rad": 0.01}}
    assert lifted(of_another_model) == of_another_model
    assert list(told_where_now(of_another_model)) == []


def test_an_area_given_twice_is_refused():
    tree = {"schema": 1, "name": "lab", "safety": {"x_range_m": [0, 1]}, "environment": {"x_range_m": [0, 2]}}
    with pytest.raises(ConfigError, match=r"safety\.x_range_m: environment\.x_range_m is given, too"):
        validate(tree, "b")


def test_a_start_outside_the_usable_area_is_refused():
    tree = {"schema": 1, "name": "lab", "environment": {"y_range_m": [0, 2], "start_pose": [0.0, 3.0, 0.0]}}
    with pytest.raises(
        ConfigError, match=r"environment\.start_pose: y = 3 m is outside y_range_m = \[0, 2\]"
    ):
        validate(tree, "b")
