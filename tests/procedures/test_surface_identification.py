"""Surface identification: recovers the emulated wall's creep and hold, and fails where it cannot."""

import math

import numpy as np
import pytest
from procedure_runs import options_of

from hil.bench import open_bench
from hil.config.loading import load_bench
from hil.core.clock import nanoseconds
from hil.core.errors import ConfigError
from hil.fakes.body_interface import JointCommand
from hil.faults.files import read_faults
from hil.procedure import BenchSource
from hil.procedure.runner import dry_run, run_procedure
from hil.procedures import surface_identification
from hil.procedures.surface_identification.slip import rate

QUICK = {
    "length_m": "0.2",
    "repetitions": "2",
    "hold_from_deg": "24",
    "hold_to_deg": "36",
    "hold_step_deg": "2",
}
WHOLE = {"length_m": "0.4", "hold_step_deg": "1"}
DAMPING_N_S_M = 30.0


def identify(folder, seed=0, parameters=QUICK, faults=(), **source):
    overrides = {"loop.rate_hz": 50.0}
    source = BenchSource(seed=seed, overrides=overrides, faults=read_faults(faults), **source)
    result = run_procedure(surface_identification.run, source, options_of(folder, dict(parameters)))
    return result, {row["name"]: row["value"] for row in result.measurements}


def true_robot(seed):
    bench = open_bench("emulated", seed=seed)
    parameters = bench.world.plant.parameters
    bench.close()
    return parameters


def creep_by_law(truth, stiffness, peak_m_s):
    """Slip per metre rolled that balances weight minus thrust: brush creep beside the damping of the tyres.

    The law of `docs/wall.md`, averaged over the way of a quintic.
    """
    downhill_n = truth.mass_kg * 9.81 - truth.thrust_n
    load_n, mu = truth.adhesion_n, truth.contact.friction
    u = np.linspace(0.0, 1.0, 201)
    speed = peak_m_s / 1.875 * 30.0 * (u**2 - 2.0 * u**3 + u**4)
    found = []
    for v in speed:
        slip = 0.0
        for _ in range(100):
            brush_n = downhill_n - 4.0 * DAMPING_N_S_M * slip * v
            give = max(1.0 - truth.contact.softening * brush_n / (mu * load_n), 0.05)
            slip = brush_n / (stiffness * load_n * give)
        found.append(slip)
    return float(np.average(found, weights=speed))


def slides(seed, heading_deg):
    """The plant alone, wheels locked after a tenth of a second: whether it moves 2 mm in 1.5 s."""
    pose = [0.0, 0.0, math.radians(heading_deg)]
    tethered = {"safety.tethered": True, "safety.heading_limit_rad": math.pi / 2}
    bench = open_bench("emulated", seed=seed, overrides={"environment.start_pose": pose, **tethered})
    plant = bench.world.plant
    plant.advance(nanoseconds(0.1))
    for joint in range(8):
        plant.command(joint, JointCommand("velocity" if joint < 4 else "position", 0.0))
    plant.advance(nanoseconds(0.105))
    before = plant.truth().pose_body_in_wall
    plant.advance(nanoseconds(1.6))
    moved = plant.truth().pose_body_in_wall - before
    bench.close()
    return math.hypot(moved[0], moved[1]) > 2e-3


def check_recovery(folder, seed, parameters):
    result, found = identify(folder, seed, parameters)
    assert result.verdict.value in ("PASS", "MARGINAL"), result.measurements
    truth = true_robot(seed)
    errors = {}
    for name, stiffness in (("slip", truth.contact.creep_along), ("sag", truth.contact.creep_across)):
        expected = 1e3 * creep_by_law(truth, stiffness, 0.1)
        errors[name] = (found[f"{name}_per_metre"] - expected) / found[f"{name}_uncertainty"]
    for side, sense in (("left", 1.0), ("right", -1.0)):
        stood = found[f"hold_angle_{side}"]
        assert not slides(seed, sense * (stood - 0.2))
        assert slides(seed, sense * (stood + 2.0 * found["hold_uncertainty"] + 0.2))
    return errors


def test_the_injected_surface_comes_back_within_the_stated_uncertainty(tmp_path):
    errors = check_recovery(tmp_path / "run", 1, QUICK)
    assert max(map(abs, errors.values())) < 1.0, errors


@pytest.mark.long
def test_over_twenty_seeds_the_stated_intervals_cover_the_truth(tmp_path):
    errors = [list(check_recovery(tmp_path / str(seed), seed, WHOLE).values()) for seed in range(20)]
    sizes = np.abs(np.array(errors))
    assert np.mean(sizes < 1.0) >= 0.9, sizes
    assert sizes.max() < 2.0, sizes


SHORT = {"length_m": "0.25", "repetitions": "2", "hold": "false"}


@pytest.mark.parametrize(
    ("fault", "verdict", "words"),
    [
        ("mocap:off", "ERROR", "no server answers"),
        ("mocap:stuck@3", "ERROR", "no usable frame"),
        ("plant:adhesion_loss@3+9,factor=0", "ERROR", "robot stopped"),
        ("servos:off@3", "ERROR", "servo"),
    ],
)
def test_it_fails_under_a_fault_that_makes_it_impossible(tmp_path, fault, verdict, words):
    result, _ = identify(tmp_path / "run", parameters=SHORT, faults=(fault,))
    assert result.verdict.value == verdict, (result.error, result.measurements)
    assert words in result.error.message
    assert result.exit_code == 3


def test_the_floor_is_refused_before_anything_is_opened(tmp_path):
    with pytest.raises(ConfigError, match="stands on the floor"):
        dry_run(surface_identification.run, BenchSource("emulated_floor"), {})
    result, _ = identify(tmp_path / "run", bench="emulated_floor")
    assert (result.error.kind, result.exit_code) == ("ConfigError", 2), result.error
    assert not list((tmp_path / "run").glob("*.mcap"))


def test_the_plan_holds_every_line_against_the_limits():
    plan = dry_run(surface_identification.run, BenchSource(load_bench("emulated")), {})
    assert plan["trajectories_checked"] == 4


def test_geometry_cancels_between_opposite_directions():
    found = rate([0.030 - 0.004, 0.031 - 0.004], [0.030 + 0.004, 0.031 + 0.004], 0.0)
    assert found.mean == pytest.approx(0.0305)
    assert found.half_width == pytest.approx(12.706 * 0.0005, rel=1e-3)
    assert rate([0.03], [0.03], 0.1).half_width == pytest.approx(0.003)


@pytest.mark.long
def test_several_processes_find_what_one_finds(tmp_path):
    lines = {"length_m": "0.2", "repetitions": "2", "hold": "false"}
    alone = identify(tmp_path / "one", parameters=lines)[1]
    together = identify(tmp_path / "two", parameters=lines | {"processes": "2"})[1]
    assert together == alone
    assert len(list((tmp_path / "one").glob("*.mcap"))) == 2
