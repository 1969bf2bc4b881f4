"""`[environment]` says what the robot stands on, and where it may go."""

import pytest

import hil
from hil.bench.loop_settings import motion_limits, safety_limits
from hil.config.environment import SURFACES
from hil.config.loading import load_bench, validate
from hil.config.unchecked import changed_since
from hil.core.errors import ConfigError
from hil.fakes.plant import surfaces

HEAD = 'schema = 1\nname = "lab"\n'


@pytest.fixture
def refused(tmp_path):
    def load(text):
        path = tmp_path / "bench.toml"
        path.write_text(HEAD + text)
        with pytest.raises(ConfigError) as error:
            load_bench(path)
        return error.value.problems

    return load


@pytest.mark.parametrize(("tilt_rad", "on_wall"), [(0.05, False), (0.3, True)])
def test_wall_or_floor_follows_from_the_tilt_of_the_emulated_world(tilt_rad, on_wall):
    with hil.open_bench("emulated", overrides={"environment.tilt_rad": tilt_rad}) as bench:
        assert bench.truth().tilt_rad == tilt_rad
        assert safety_limits(bench.config).on_wall is on_wall
        assert bench.model.alignment_parameters.on_wall is on_wall
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


def test_a_start_outside_the_usable_area_is_refused():
    tree = {"schema": 1, "name": "lab", "environment": {"y_range_m": [0, 2], "start_pose": [0.0, 3.0, 0.0]}}
    with pytest.raises(
        ConfigError, match=r"environment\.start_pose: y = 3 m is outside y_range_m = \[0, 2\]"
    ):
        validate(tree, "b")


def test_what_has_changed_since_a_recording_is_named_by_its_key():
    now = load_bench("emulated")
    recorded = now.model_dump(mode="json", by_alias=True)
    assert changed_since(recorded, now) == []
    other = load_bench("emulated", overrides={"environment.tilt_rad": 1.5, "imu": None})
    assert changed_since(recorded, other) == ["environment.tilt_rad", "imu"]
