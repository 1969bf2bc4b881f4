"""The robot in MuJoCo: same seed, same bits; truth with the same fields; one that diverges is an error."""

import dataclasses

import numpy as np
import pytest
from mujoco_driving import mujoco, robot
from plant_driving import MS_NS, build, drive, settle, wait

from hil.core.errors import DeviceError
from hil.fakes.plant.mujoco import CONTACTS
from hil.fakes.plant.mujoco.model import as_built, build_model


def _bits(plant):
    t = plant.truth()
    return [np.asarray(getattr(t, field.name)).tobytes() for field in dataclasses.fields(t)]


@pytest.mark.parametrize("contact", ["holding", "creep"])
def test_neither_another_run_nor_the_split_of_time_changes_a_bit(contact):
    plants = [robot(1, random=True, contact=contact) for _ in range(3)]
    for plant in plants:
        settle(plant)
        drive(plant, 3.0, 0.3)
    for plant in plants[:2]:
        wait(plant, 0.5)
    rng, parts = np.random.default_rng(0), plants[2]
    while parts.t_ns < plants[0].t_ns:
        parts.advance(min(plants[0].t_ns, parts.t_ns + int(rng.integers(1, 9)) * MS_NS + 7))
    assert _bits(plants[0]) == _bits(plants[1]) == _bits(parts)


def test_one_seed_is_one_robot_in_both_worlds():
    ours, theirs = build(4, random=True), robot(4, random=True)
    p, q = ours.parameters, theirs.parameters
    np.testing.assert_allclose(q.wheel_x_m, p.wheel_x_m, atol=1e-9)
    np.testing.assert_allclose(q.wheel_radius_m, p.wheel_radius_m, rtol=0.004)
    assert q.mass_kg == pytest.approx(p.mass_kg, rel=1e-9)
    assert (q.adhesion_n, q.thrust_n) == (p.adhesion_n, p.thrust_n)
    np.testing.assert_array_equal(q.joints.play_rad, p.joints.play_rad)
    assert theirs._built.contact.creep_per_n != robot(5, random=True)._built.contact.creep_per_n


def test_the_generated_robot_weighs_what_it_is_said_to():
    said = build(3, random=True).parameters
    fresh = build_model(said, CONTACTS["creep"])
    found = as_built(fresh, said)
    assert found.mass_kg == pytest.approx(said.mass_kg, rel=1e-6)
    np.testing.assert_allclose(found.centre_of_mass_m, said.centre_of_mass_m, atol=1e-6)
    turning, momentum = np.zeros(fresh.model.nv), np.zeros(fresh.model.nv)
    turning[5] = 1.0
    mujoco.mj_mulM(fresh.model, fresh.data, momentum, turning)
    about_origin = said.yaw_inertia_kg_m2 + said.mass_kg * np.hypot(*said.centre_of_mass_m[:2]) ** 2
    assert momentum[5] == pytest.approx(about_origin, rel=0.01)


def test_truth_has_the_fields_and_shapes_of_the_own_plant():
    ours, theirs = build().truth(), robot().truth()
    for field in dataclasses.fields(ours):
        a, b = (np.asarray(getattr(t, field.name)) for t in (ours, theirs))
        assert (a.shape, a.dtype) == (b.shape, b.dtype), field.name
    with pytest.raises(ValueError, match="read-only"):
        theirs.pose_body_in_wall[0] = 1.0


def test_halving_the_step_gives_the_same_path():
    ends = []
    for step_s in (0.002, 0.001):
        plant = robot(step_s=step_s)
        settle(plant)
        drive(plant, 3.0)
        wait(plant, 4.0)
        ends.append(plant.truth().pose_body_in_wall)
    assert np.abs(ends[0] - ends[1])[:2].max() <= 1e-4


def test_a_simulation_that_diverges_is_an_error_of_the_plant_and_no_verdict(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant = robot()
    settle(plant)
    plant._built.data.qvel[2] = np.nan
    with pytest.raises(
        DeviceError, match=r"MuJoCo simulation of the generated robot has diverged at 1\.0"
    ) as e:
        wait(plant, 0.1)
    assert e.value.exit_code == 3
    assert list(tmp_path.iterdir()) == []  # MuJoCo's own log
