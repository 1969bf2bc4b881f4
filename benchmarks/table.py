"""What `make bench` prints: one table, ours beside a peer in the same run, and how cost grows.

    python benchmarks/table.py
    python benchmarks/table.py --only estimator,growth --out out/bench

Runs the other benchmarks of speed one after the other, each in a process of its own, and gathers their
figures. `ratio` is how many times as good as the peer ours is. The peer of a rig in virtual time is real time
itself. Leaves `bench.json` and `bench.svg` in the folder. Nothing else should run meanwhile; ratios of two
things that ran in turns bear it, times in microseconds do not.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.report.plot_style import SERIES, legend, new_figure, style

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Row:
    """One line: what was measured, ours and the peer's figure in `unit`, how many times as good ours is."""

    what: str
    ours: float
    peer: str
    theirs: float
    unit: str
    ratio: float


def _slower(what: str, ours: float, peer: str, theirs: float, unit: str) -> Row:
    return Row(what, ours, peer, theirs, unit, theirs / ours)


def _faster(what: str, ours: float, peer: str, theirs: float, unit: str) -> Row:
    return Row(what, ours, peer, theirs, unit, ours / theirs)


def of_estimator(result: Any) -> Iterator[Row]:
    """Our engines against filterpy's."""
    for kind, it in result.items():
        yield _slower(f"{kind.upper()}, one sample", it["ours_us"], "filterpy", it["filterpy_us"], "us")


def of_servo_bus(result: Any) -> Iterator[Row]:
    """Our servo driver against the DYNAMIXEL SDK."""
    it = result["sync_read"]
    yield _faster("servo bus, rate", it["ours_hz"], "DYNAMIXEL SDK", it["sdk_hz"], "Hz")
    yield _slower(
        "servo bus, processor time of a cycle",
        it["ours_cpu_us_per_cycle"],
        "DYNAMIXEL SDK",
        it["sdk_cpu_us_per_cycle"],
        "us",
    )


def of_calibration(result: Any) -> Iterator[Row]:
    """One evaluation of the cost against a plain loop."""
    it = result["cost"]
    yield _slower("calibration, one cost", it["ours_ms"], "plain Python loop", it["loop_ms"], "ms")


def of_virtual_bench(result: Any) -> Iterator[Row]:
    """The rig against real time."""
    yield _faster("emulated rig in virtual time", result["ratio"], "real time", 1.0, "x")


def of_second_physics(result: Any) -> Iterator[Row]:
    """MuJoCo's plant against ours."""
    real = result["times_real_time"]
    for name, value in real.items():
        if name != "own":
            yield _faster(f"climb, plant {name}", value, "own plant", real["own"], "x real time")


def of_plant(result: Any) -> Iterator[Row]:
    """The plant alone against real time."""
    yield _faster("physics of the robot alone", result["compiled"], "real time", 1.0, "x")


def of_replay(result: Any) -> Iterator[Row]:
    """Replay against real time."""
    for name, words in (
        ("verify", "replay, every bit verified"),
        ("compare", "replay, four estimators compared"),
    ):
        yield _faster(words, result[name]["median"], "real time", 1.0, "x")


BENCHMARKS: dict[str, tuple[Sequence[str], Callable[[Any], Iterator[Row]]]] = {
    "estimator": (["--json"], of_estimator),
    "servo_bus": ([], of_servo_bus),
    "calibration": (["--json"], of_calibration),
    "virtual_bench": ([], of_virtual_bench),
    "plant": ([], of_plant),
    "second_physics": ([], of_second_physics),
    "replay": (["--seconds", "40", "--runs", "3"], of_replay),
}


def ran(name: str, given: Sequence[str]) -> str:
    """What a benchmark prints.

    Raises:
        SystemExit: it printed nothing that can be read.
    """
    command = [sys.executable, str(HERE / f"{name}.py"), *given]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if not done.stdout.strip():
        raise SystemExit(f"benchmarks/{name}.py printed nothing (exit code {done.returncode})")
    return done.stdout


def printed(rows: Sequence[Row], growth: Mapping[str, Any]) -> None:
    """Both tables."""
    table = Table("what", "ours", "peer", "its", "", "ratio", title="Speed, beside a peer in the same run")
    for row in rows:
        table.add_row(
            row.what, f"{row.ours:.4g}", row.peer, f"{row.theirs:.4g}", row.unit, f"{row.ratio:.3g}"
        )
    grown = Table("grows with", "from", "to", "cost from (s)", "to (s)", "exponent", title="How cost grows")
    for name, it in growth.items():
        ends = (f"{it[key][k]:.4g}" for key in ("sizes", "seconds") for k in (0, -1))
        grown.add_row(name, *ends, f"{it['exponent']:.2f}")
    for one in (table, grown):
        if one.row_count:
            Console(width=110).print(one)


def drawn(rows: Sequence[Row], growth: Mapping[str, Any], path: Path) -> None:
    """Ratios as bars, growth as lines, both on logarithmic axes."""
    figure = new_figure(9.0, 0.8 + 0.34 * max(len(rows), 8))
    bars, curves = figure.subplots(1, 2)
    style(bars, "times as good as the peer", "")
    bars.barh(range(len(rows)), [row.ratio for row in rows], color=SERIES[0])
    bars.set_yticks(range(len(rows)), [f"{row.what}\nagainst {row.peer}" for row in rows], fontsize=7)
    bars.invert_yaxis()
    bars.set_xscale("log")
    bars.axvline(1.0, color=SERIES[1], lw=1.0)
    style(curves, "size over the smallest", "cost over the smallest")
    for colour, (name, it) in zip(SERIES * 2, growth.items(), strict=False):
        size, cost = np.array(it["sizes"]), np.array(it["seconds"])
        label = f"{name}: exponent {it['exponent']:.2f}"
        curves.loglog(size / size[0], cost / cost[0], "o-", ms=3, color=colour, label=label)
    if growth:
        top = max(max(it["sizes"]) / min(it["sizes"]) for it in growth.values())
        curves.loglog([1, top], [1, top], "--", lw=1.0, color="grey", label="linear")
        ticks = 2.0 ** np.arange(int(np.log2(top)) + 1)
        for axis in (curves.xaxis, curves.yaxis):
            axis.set_ticks(ticks)
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
        legend(curves)
    figure.savefig(path)


def main() -> None:
    """Run what was asked for, print, and leave the files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join([*BENCHMARKS, "growth"]), help="benchmarks, by commas")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    given = parser.parse_args()
    rows: list[Row] = []
    growth: dict[str, Any] = {}
    for name in given.only.split(","):
        print(f"benchmarks/{name}.py ...", file=sys.stderr, flush=True)
        if name == "growth":
            growth = {key: it for key, it in json.loads(ran(name, [])).items() if isinstance(it, dict)}
            continue
        options, read = BENCHMARKS[name]
        rows += read(json.loads(ran(name, options)))
    printed(rows, growth)
    given.out.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    facts = {"on": machine, "rows": [asdict(row) for row in rows], "growth": growth}
    (given.out / "bench.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    drawn(rows, growth, given.out / "bench.svg")
    print(f"{given.out}/bench.json, {given.out}/bench.svg")


if __name__ == "__main__":
    main()
