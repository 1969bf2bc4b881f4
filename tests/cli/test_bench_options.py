"""Options of the bench, wherever they stand on a command, come to it as one request."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hil.cli import cli, main
from hil.cli.bench_options import BenchRequest, bench_options

SHARED = ("--bench", "--emulate", "--set", "--seed", "--start", "--realtime", "--fault", "--calibration")


@click.command()
@bench_options("bench", bench={"default": None})
@click.option("--between")
@bench_options("seed", "faults", "calibration", seed={"help": "Of the dice."})
def own(request: BenchRequest, between: str | None) -> int:
    """A command with options of its own between those of the bench."""
    click.echo(repr((request, between)))
    return 0


@pytest.mark.parametrize(
    ("line", "asked", "between"),
    [
        ([], BenchRequest(), None),
        (
            ["--fault", "imu:off", "--between", "x", "--bench", "b", "--seed", "7", "--fault", "tracker:off"],
            BenchRequest("b", seed=7, faults=("imu:off", "tracker:off")),
            "x",
        ),
        (["--calibration", "c.toml"], BenchRequest(calibration=Path("c.toml")), None),
    ],
)
def test_all_options_come_as_one_request(line: list[str], asked: BenchRequest, between: str | None) -> None:
    found = CliRunner().invoke(own, line)
    assert found.output.strip() == repr((asked, between)), found.output


def test_start_and_settings_of_a_request_reach_the_bench() -> None:
    asked = BenchRequest(seed=4, start_pose="0.5, 1.0, 90deg", emulate="all")
    source = asked.source({"loop.rate_hz": 50.0}, otherwise="emulated_floor")
    assert (source.seed, source.config.loop.rate_hz) == (4, 50.0)
    assert source.config.environment.start_pose == pytest.approx((0.5, 1.0, 1.5707963267948966))
    assert BenchRequest(bench="emulated").source({}, otherwise="emulated_floor").bench == "emulated"


@pytest.mark.parametrize("command", ["accept", "live"])
def test_a_bench_without_a_name_is_not_the_emulated_one(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([command, "--bench", ""]) == 2


@pytest.mark.parametrize("option", SHARED)
def test_an_option_of_the_bench_is_of_one_kind_wherever_a_command_opens_a_bench(option: str) -> None:
    with click.Context(cli) as context:
        opening = ("run", "live", "accept", "commission", "doctor", "campaign")
        commands = [cli.get_command(context, name) for name in opening]
    found = [p for command in commands if command for p in command.params if option in p.opts]
    assert found
    assert len({(p.name, type(p.type), p.multiple, p.nargs) for p in found}) == 1
