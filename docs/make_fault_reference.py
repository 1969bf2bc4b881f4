"""Writes `faults.md`, every fault that emulated devices can produce, and the table of `hil list faults`."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import hil
from hil.bench.emulated_devices import supported_faults
from hil.cli.declared import FAULTS as TABLE
from hil.cli.declared import TABLED
from hil.config.loading import load_bench
from hil.core.registry import kinds
from hil.core.signals import KINDS as KINDS_HERE
from hil.faults.fault import (
    DELAY_S,
    DUTY,
    FACTOR,
    MEANINGS,
    OPTIONS,
    PERIOD_S,
    PROBABILITY,
    VOCABULARY,
    Supported,
)
from hil.faults.messages import GAP_S, PIECE_BYTES
from hil.faults.permission import BY_WIRE, LONGEST_TRAVEL_M, ON_A_WALL, SEES_A_SLIDE, SERVOS_ON_A_WALL

PAGE = Path(__file__).with_name("faults.md")
ROOT = Path(hil.__file__).resolve().parent
HEAD = """# Faults

Devices can have faults on request, so that you can test how the bench and your code react: emulated
devices at the chip, [real devices](#real-devices) at the link. A fault consists of a device, a kind, a time
and options:

```
DEVICE:KIND[@START_S[+DURATION_S]][,OPTION=NUMBER...]

imu:stuck@2+3                        from second 2 to second 5
servo.drive_FL:off@5                 from second 5 to the end
tracker:wrong@1,scale=0.8            a camera that sees every step a fifth too short
servos:drop@0+10,probability=0.2     every fifth reply is lost, for ten seconds
servos:silent@3+0.5,direction=both   half a second without any message, also towards emulated servos
```

`hil run`, `hil live` and `hil emulate` take a fault as `--fault` (repeatable). In the bench file it is
`[emulation] faults = ["imu:stuck@2+3"]`, in a pytest test `@pytest.mark.fault("imu", "stuck", at=2.0,
duration=3.0)`. A run or a session that ends before its fault has begun reports this; a test fails. The same
holds for a fault that begins only while the closing bench checks that the stopped robot is held. A fault
without effect, shorter than 1 ms or of probability 0, is refused.

A path that ends in `.toml` is a timeline of several faults:

```toml
[[fault]]
device = "imu"
kind = "stuck"
at_s = 2.0
duration_s = 3.0                     # without it: until the end
options = { }
```

**World time.** Seconds count from the start of the emulated world, not of the motion. Opening the devices
takes the first 0.44 s on the shipped profile: a fault at 0 acts on devices that are being opened. In virtual
time, world time is the bench's clock; `hil emulate --await-start` stops it until the client is ready. Without
a start a fault acts from the beginning, without a duration to the end. `reset` and `jump` act once, at the
start; `jump` of motion capture lasts. Of two faults of one kind on one device the one that began last counts.

**One draw per message.** A fault with a probability draws once for each message: a reply of a bus (all that
the servos send to one request, in one packet or in eight), a packet of a stream, a frame, a datagram. What
becomes of a message is one rule for all wires. It acts on messages from the device unless `direction` says
otherwise: replies are lost, and commands still arrive. (The propellers' Teensy never sends: there it acts on
the commands.) What a lost message costs depends on the driver. A BNO055 loses about a sample with each reply.
Servos are read again where `retry_budget_s` allows it, and always if they are asked ahead. Without that, one
damaged bit in 20 % of the replies costs 2.5 % of a servo's values in plain reads, each of whose eight packets
has a checksum of its own. In fast reads each checksum covers all servos before it, too: the first one loses
3.7 % of its values, the last one 20 %; as places change, 12 % each.

**Timeout of a silent sensor.** The bench waits for `fail_after_s` of the sensor's table in the bench file:
3 s for an IMU, 2 s for camera and motion capture, 1 s for encoders and load cells, unless you change it.
Longer silence ends the drive, or the observation at rest, with `DeviceTimeoutError` (exit code 3). This
holds in virtual time, at the wire, in a mix and on the real bench. In real time a port that has disappeared
is reopened meanwhile, and a sensor that returns in time continues. If a procedure catches the error, it
continues, and a note in `result.json` and in the report names the device and the length of the silence.
Only a session of `hil live` that does not drive the robot waits longer: up to 10 s more.

[Several devices of one kind](bench-file.md#several-devices-of-one-kind) are addressed by name:
`imu_arm:stuck`.

An unknown device or option, or a fault that a device cannot produce, is refused before anything is opened.

## Real devices

In front of a real device the bench can lose, damage, repeat and delay what the device sends. The same
spec, timeline and marker are used. Two consents are needed: the bench file says what may ever be
injected, the command line that it is meant now (`--inject-real` of `hil run` and `hil live`,
`--hil-inject-real` of pytest).

```toml
[faults]
real = "floor"                       # or "none" (default), "tethered", "wall"
devices = ["tracker", "imu"]         # no others
```

`hil faults --bench my.toml --inject-real` runs the matrix on real devices: each fault that the bench file
permits, at four moments of a drive of 12 cm on the floor or on a tether. Without a fault the robot returns
to its start after each cell, and motion capture takes the place of the emulated truth.

{LINKS}
* **Never towards a device.** Commands are neither altered nor lost. The fan's commands come from a
  process that has no faults.
* **On a wall without a tether** only
  {WALL};
  of the servo bus {SERVOS}, for 1 s at most; none of fan and propellers. At any time one of
  {SEES} has no fault; load cells count only where the fan holds the robot
  without propellers that do not report their push. All motions together lead at most {TRAVEL:g} m away, by
  the sensors that have no fault at the time; farther on the robot is stopped (`injected_travel`).
  A path that is known beforehand (`hil live --trajectory FILE.csv`, the plan of a procedure) and leads
  farther from its first place is refused before a port is opened.
* **A fault ends when the robot is stopped**, whatever stops it, and before HELD is judged. It exists in
  the bench's own process only.
* A fault that hits no message is an error of the run or the test. `injected` of `result.json`, and the
  page, say for each fault whether it was at the chip or at the link, when, and how many messages it hit.
* Power and content are not of the link: `off`, `brownout`, `reset`, `stuck`, `wrong` and `jump` are
  refused. `silent` withholds what the device sends. A single servo or encoder has no link of its own.
* **By hand.** With `hil run --by-hand`, at a terminal, the operator is asked to switch the power for `off`,
  `brownout` and `reset` while the bench goes on. `injected` then says `hand`, with the times of Enter. What
  nobody did is an error. On a wall without a tether a hand leaves servos, fan and propellers alone. Emulated
  devices have these faults at the chip, with or without the option.

Without a plan nothing is wrapped. A fault that has not begun costs about 1 % of the processor time of a servo
cycle (4 to 5 us; `armed` of `python benchmarks/servo_bus.py`).

On a CAN bus with several nodes a fault hits the frames of the named device only. A PASS with faults at the
link says nothing about faults of the power. No real device has been tried.

This page is written by `docs/make_fault_reference.py` from the declarations of the devices.
"""
LINKS = "\n".join(
    (
        "| wire | faults |",
        "|---|---|",
        *(
            f"| {title} | {', '.join(f'`{kind}`' for kind in BY_WIRE[wire])} |"
            for title, wire in (
                ("servo bus, BNO055", "bus"),
                ("other serial lines", "serial"),
                ("lines of text", "lines"),
                ("CAN", "can"),
                ("UDP", "udp"),
                ("T265", "poses"),
            )
        ),
        "",
    )
)
SHARED = {
    "period_s": f"{PERIOD_S:g}",
    "duty": f"{DUTY:g}",
    "probability": f"{PROBABILITY:g}",
    "factor": f"{FACTOR:g}",
    "delay_s": f"{DELAY_S:g}",
    "size": f"{PIECE_BYTES}",
    "gap_s": f"{GAP_S:g}",
}
_INHERITED = re.compile(
    r"from (hil\.fakes\.(?:imu\.inertial_faults|tracker\.pose_errors|motor_controllers\.\w+)) import"
)
_ASKED = re.compile(r'find\(\s*(?:[\w.]+,\s*)*"(\w+)"|\.option\("(\w+)",\s*([\w.]+)\)|delay_ns\((_\w+)\)')


def page() -> str:
    """The whole page."""
    head = HEAD.replace("{LINKS}", LINKS)
    for name, words in (("WALL", ON_A_WALL), ("SERVOS", SERVOS_ON_A_WALL), ("SEES", SEES_A_SLIDE)):
        order = words if name == "SEES" else sorted(words)
        head = head.replace(f"{{{name}}}", ", ".join(f"`{word}`" for word in order))
    head = head.replace("{TRAVEL:g}", f"{LONGEST_TRAVEL_M:g}")
    return "".join((head, *_kinds(), *_options(), *_devices()))


def table() -> str:
    """What `hil list faults` says of the shipped bench: by device and kind the options, a device a line."""
    declared = supported_faults(load_bench(TABLED, emulate="all"))
    lines = (f"{json.dumps(name)}: {json.dumps(faults)}" for name, faults in declared.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _kinds() -> Iterator[str]:
    yield "\n## Kinds\n\n| kind | what happens |\n|---|---|\n"
    yield from (f"| `{kind}` | {meaning} |\n" for kind, meaning in MEANINGS.items())


def _options() -> Iterator[str]:
    yield "\n## Options\n\nOutside its range an option is refused, too.\n"
    yield "\n| option | range | meaning |\n|---|---|---|\n"
    for name, option in OPTIONS.items():
        kind, _, short = name.rpartition(":")
        yield f"| `{short}`{f' of `{kind}`' if kind else ''} | {option.range} | {option.meaning} |\n"


def _devices() -> Iterator[str]:
    yield "\n## Devices\n\nOptions with their defaults; a kind without options takes none.\n"
    for kind in map(kinds().__getitem__, KINDS_HERE):
        for model in kind.models:
            if model.emulate is None:
                continue
            several = f' with model = "{model.name}"' if len(kind.models) > 1 else ""
            yield from _table(f"{model.title}{several}", _declared(kind.name, model.name), _room(model))
    yield from _table("The robot on its surface", {"plant": _world({})["plant"]}, "hil.fakes.plant")


def _world(tables: dict[str, object]) -> dict[str, Supported]:
    config = load_bench("emulated")
    return supported_faults(type(config).model_validate({"schema": 1, "name": "faults", **tables}))


def _declared(kind: str, model: str) -> dict[str, Supported]:
    found = _world({kind: {"model": model, "backend": "emulated"}})
    return {name: faults for name, faults in found.items() if name != "plant"}


def _room(model: object) -> str:
    return model.chip.partition(":")[0].rpartition(".")[0]  # type: ignore[attr-defined]


def _table(title: str, declared: dict[str, Supported], room: str) -> Iterator[str]:
    defaults = _defaults(room)
    yield f"\n### {title}\n\n| device | kinds |\n|---|---|\n"
    for faults, names in groupby(declared, key=lambda name: tuple(declared[name].items())):
        listed = ", ".join(_with_options(kind, options, defaults) for kind, options in faults)
        yield f"| {', '.join(f'`{name}`' for name in names)} | {listed} |\n"


def _with_options(kind: str, options: tuple[str, ...], defaults: dict[tuple[str, str], str]) -> str:
    shown = [
        f"`{option}{f'={value}' if (value := _default(kind, option, defaults)) else ''}`"
        for option in options
    ]
    return f"`{kind}`" + (f" ({', '.join(shown)})" if shown else "")


def _default(kind: str, option: str, defaults: dict[tuple[str, str], str]) -> str:
    return defaults.get((kind, option)) or defaults.get(("", option)) or SHARED.get(option, "")


def _defaults(room: str) -> dict[tuple[str, str], str]:
    """Default of an option by kind, from the lines of a room, and of those it builds on, that ask for it."""
    found: dict[tuple[str, str], str] = {}
    own = [f"{room}.{path.stem}" for path in sorted((ROOT / Path(*room.split(".")[1:])).glob("*.py"))]
    texts = {name: _source(name) for name in own}
    built_on = {name for text in texts.values() for name in _INHERITED.findall(text)} - texts.keys()
    texts |= {name: _source(name) for name in sorted(built_on)}
    for name, text in texts.items():
        module, kind = importlib.import_module(name), ""
        if ".period_factor" in text:
            found.setdefault(("slow", "factor"), SHARED["factor"])
        for match in _ASKED.finditer(text):
            asked, option, value, delay = match.groups()
            kind = asked or kind
            if option or delay:
                number = getattr(module, value or delay, value)
                found.setdefault(
                    (kind if kind in VOCABULARY else "", option or "delay_s"), f"{float(number):g}"
                )
                found.setdefault(("", option or "delay_s"), f"{float(number):g}")
    return found


def _source(module: str) -> str:
    return (ROOT / Path(*module.split(".")[1:])).with_suffix(".py").read_text(encoding="utf-8")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    TABLE.write_text(table(), encoding="utf-8")
