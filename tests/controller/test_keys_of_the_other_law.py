"""A key of the bench file that only the other control law reads: said where it is set and compared.

A student varied `control.gains` under the default law: the same values to the last bit, and nobody said why.
"""

import json

import numpy as np
import pytest

from hil.bench import open_bench
from hil.campaign.ineffective_settings import in_a_sentence
from hil.cli import main
from hil.config.control import ControlConfig, law_of
from hil.config.loading import load_bench
from hil.robot.trajectories import line

GAINS = {"control.gains": [8.0, 8.0, 3.0]}


def drive(law, overrides):
    with open_bench(load_bench("emulated_floor", overrides=overrides)) as bench:
        motion = bench.drive(
            line((0, 0, 0), (0.05, 0, 0), duration_s=2.0), controller=law, feedback="odometry"
        )
        return motion.estimate, [warning for warning in bench.warnings if "control law" in warning]


@pytest.mark.parametrize(("law", "reads"), [("optimal", False), ("nonlinear", True)])
def test_a_drive_warns_of_a_key_just_where_it_changes_nothing(law, reads):
    (plain, unwarned), (changed, warned) = drive(law, {}), drive(law, GAINS)
    assert not unwarned
    assert np.array_equal(plain, changed) != reads
    assert bool(warned) != reads
    assert all(line.startswith("control.gains belongs to the other control law") for line in warned)


def test_every_key_is_of_one_law_or_of_both():
    of_optimal = {key for key in ControlConfig.model_fields if law_of(f"control.{key}") == "optimal"}
    assert of_optimal == {
        "integral",
        "state_weight",
        "integral_weight",
        "input_weight",
        "integral_clamp",
        "servo_lag_s",
    }
    assert law_of("config.control.gains") == law_of("bench.control.gains") == "nonlinear"
    assert law_of("control.law") is law_of("gains") is None
    assert "control.law = 'nonlinear'" in in_a_sentence({"key": "bench.control.gains", "values": ["a", "b"]})
    assert "control.law" not in in_a_sentence({"key": "bench.loop.rate_hz", "values": ["a", "b"]})


def test_a_comparison_says_which_law_reads_a_key_that_differs(tmp_path, capsys):
    (tmp_path / "short.py").write_text(
        "from hil.procedure import procedure\n\n\n@procedure(name='short', needs=())\n"
        "def run(ctx):\n    'Do nothing.'\n    with ctx.step('nothing'):\n        pass\n"
    )
    for name, gain in (("a", 4), ("b", 8)):
        setting = f"bench.control.gains=[{gain},{gain},3]"
        main(["run", str(tmp_path / "short.py"), "--set", setting, "--out", str(tmp_path / name), "--json"])
    capsys.readouterr()
    assert main(["report", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    said = capsys.readouterr().out
    assert "only the control law 'nonlinear' reads it" in said
    main(["report", str(tmp_path / "a"), str(tmp_path / "b"), "--json"])
    (row,) = [r for r in json.loads(capsys.readouterr().out)["differences"] if r["key"].endswith("gains")]
    assert row["law"] == "nonlinear"
