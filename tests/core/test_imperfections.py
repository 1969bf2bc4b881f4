"""Values of `[emulation.KIND]` that cannot be meant are refused with their key before anything opens."""

import dataclasses
import math
from typing import Annotated

import pytest

from hil.bench import check_faults
from hil.cli import main
from hil.config.field_types import Within
from hil.config.loading import load_bench
from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.fakes.emulated_device import EmulationRequest
from hil.fakes.imperfection_bounds import invalid_values, ranges

SIGNED = {"ambient_c"}
NUMBERS = [
    pytest.param(kind.name, model, field, id=f"{kind.name}-{model.name}-{field.name}")
    for kind in kinds().values()
    for model in kind.models
    if model.truth_options() is not None
    for field in dataclasses.fields(model.truth_options())
    if field.name in ranges(model.truth_options())
]


def options(model, values):
    return EmulationRequest(model.kind, None, values, None, "x").options(model.truth_options())


@pytest.mark.parametrize(("kind", "model", "field"), NUMBERS)
def test_no_number_of_any_device_takes_nonsense_and_each_takes_its_default(kind, model, field):
    assert all(ranges(model.truth_options())[field.name])
    wrong = ["x", True, math.nan, math.inf, 1e300, 10**400]
    if isinstance(field.default, float):
        wrong += [1e9] if field.name in SIGNED else [1e9, -1]
    if not isinstance(field.default, (int, float)) or isinstance(field.default, bool):
        return
    for value in wrong:
        with pytest.raises(ConfigError, match=rf"emulation\.{kind}\.{field.name}: "):
            options(model, {field.name: value})
    assert getattr(options(model, {field.name: field.default}), field.name) == field.default


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("servos.ids", [1] * 8),
        ("servos.model_number", 7),
        ("servos.eeprom", {"1": {"x": 1}}),
        ("servos.eeprom", {"1": {"velocity_limit": 10**12}}),
        ("servos.model_by_joint", {"9": 1010}),
        ("servos.drive_start_counts", [10**12, 0, 0, 0]),
        ("tracker.settle_s", [0.1, float("nan"), 0.1]),
        ("tracker.mount_rotation_wxyz", [0.0] * 4),
        ("imu.leakage_s", 0.0),
    ],
)
def test_a_bench_is_checked_without_any_fault(key, value):
    config = load_bench("emulated", overrides={f"emulation.{key}": value})
    with pytest.raises(ConfigError, match=rf"emulation\.{key}"):
        check_faults(config, [])


@pytest.mark.parametrize("given", ["scale_sigma=-1", 'boot_s="x"'])
def test_a_run_ends_with_2_before_it_has_begun(tmp_path, capsys, given):
    out = tmp_path / "out"
    assert main(["run", "latency", "--set", f"bench.emulation.tracker.{given}", "--out", str(out)]) == 2
    reported = capsys.readouterr()
    assert f"emulation.tracker.{given.partition('=')[0]}: " in reported.err
    assert "NOT HELD" not in reported.err + reported.out
    assert not out.exists()


@pytest.mark.parametrize("command", [["emulate"], ["doctor"]])
def test_every_command_that_emulates_checks(tmp_path, capsys, command):
    bench = tmp_path / "bench.toml"
    bench.write_text(
        'schema = 1\nname = "x"\n[imu]\nbackend = "emulated"\n[emulation.imu]\ngyro_noise_rad_s = -1.0\n'
    )
    assert main([*command, "--bench", str(bench)]) == 2
    assert "emulation.imu.gyro_noise_rad_s: expected 0 to 100, found -1" in capsys.readouterr().err


def test_wrong_values_are_reported_all_at_once():
    config = load_bench("emulated", overrides={"emulation.imu": {"clock_ppm": -1, "leakage_s": 0}})
    with pytest.raises(ConfigError) as error:
        check_faults(config, [])
    assert [p.partition(":")[0] for p in error.value.problems] == [
        "emulation.imu.clock_ppm",
        "emulation.imu.leakage_s",
    ]


def test_a_device_may_have_bounds_of_its_own():
    @dataclasses.dataclass(frozen=True)
    class Own:
        """Another package's device."""

        slope_rad: Annotated[float, Within(-9.0, 9.0, "it may lean")] = 0.0
        gain: float = 1.0

    assert not list(invalid_values(Own, {"slope_rad": -8.0, "gain": -1e6}))
    assert [key for key, _ in invalid_values(Own, {"slope_rad": float("nan"), "gain": float("inf")})] == [
        "slope_rad",
        "gain",
    ]
    assert list(invalid_values(Own, {"gain": False})) == [("gain", "expected a number, found false")]
    assert not list(invalid_values(Own, {"gain": 10**400}))
