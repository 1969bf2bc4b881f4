"""adhesion_check finds zeros, force and friction that an emulated robot truly has."""

import pytest
from procedure_runs import part, run, true_world

from hil.fakes.load_cells.hx711.chip import CellNode

SHORT = {"levels": 3, "dwell_s": 0.5}
OVERRIDES = {"emulation.load_cells.drift_n_per_min": 0.0, "loop.rate_hz": 50.0}


def test_zeros_force_margin_and_friction_are_those_of_the_robot(tmp_path):
    seed = 3
    done = run("adhesion_check", tmp_path / "run", SHORT, seed=seed, overrides=OVERRIDES)
    assert done.result.exit_code == 0, done.failed or done.result.error
    done.assert_held()
    world = true_world("emulated", seed, OVERRIDES)
    truth, cells = world.plant.parameters, part(world, CellNode)._cells
    values = done.values
    for k in (0, 1):
        assert values[f"cells_zero_{k + 1}"] == pytest.approx(cells._zero_n[k], abs=0.2)
    scale = sum(s * share for s, share in zip(cells._scale, cells._share, strict=True))
    assert values["rated_force"] == pytest.approx(scale * truth.working_point.adhesion_n, rel=0.01)
    slides_n = (truth.mass_kg * 9.81 - truth.thrust_n) / truth.contact.friction
    assert values["slides_at"] == pytest.approx(slides_n, rel=0.08)
    assert values["friction"] == pytest.approx(truth.contact.friction, rel=0.08)
    assert (tmp_path / "run" / "bench_fragment.toml").read_text().count("zero_n") == 1
    assert any(f["title"] == "Adhesion" for f in done.result.facts["figures"])
    assert any("Pressed on the wall with" in note for note in done.result.facts["notes"])
