"""Examines a bench without moving it: what answers, how well, and what to do about what does not.

Every device is opened by itself, so that one that is missing does not hide the others, and then read
at the loop rate for a while. The findings are data; `hil doctor` prints them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.bench import Bench
from hil.bench.settings import wheel_model
from hil.config.xh430 import hardware_error_text
from hil.drivers.serial_url import latency_timer
from hil.vocabulary.clock import nanoseconds
from hil.vocabulary.errors import HilError
from hil.vocabulary.finding import Finding, Level
from hil.vocabulary.interfaces import Device
from hil.vocabulary.signals import SERVOS, WHEELS, Status

_WATCH_S = 2.0
_SETTLE_S = 0.6
_LOW_SUPPLY_V, _HOT_C = 10.0, 70.0
_LOSS_WARNING, _LOSS_FAILURE = 0.02, 0.2
_LATENCY_TIMER_S = 0.001
_SYSFS = Path("/sys")
_SHOWN_BY_SAMPLES = ("hardware errors",)
_SLOWNESS, _HURT_BY_SLOWNESS = ("latency timer", "reply time"), ("open", "read", "samples")
_GRAVITY_M_S2, _GRAVITY_TOLERANCE_M_S2 = 9.81, 0.5
_LATE_MOCAP_S, _MOCAP_GAP_S = 0.05, 0.3


def examine(bench: Bench, *, watch_s: float = _WATCH_S, sysfs: Path = _SYSFS) -> Iterator[Finding]:
    """Findings about the calibration and every device of a bench that has not been entered.

    Args:
        bench: as `open_bench` returned it; its devices are opened and closed here.
        watch_s: how long each is read.
        sysfs: where the kernel tells of its devices.
    """
    try:
        bench.begin()
        yield from _calibration(bench)
        for device in bench.rig.devices():
            yield from _examine_one(bench, device, watch_s, sysfs)
    finally:
        bench.close()


def _calibration(bench: Bench) -> Iterator[Finding]:
    """Calibrated wheels belong to the wheel model that they were fitted with."""
    if not bench.calibration:
        return
    used, wanted = bench.config.estimator.wheels.model, wheel_model(bench.fitted_with)
    level: Level = "ok" if used == wanted else "warning"
    found = f"{bench.calibration}, fitted with the {bench.fitted_with} model; estimated with {used}"
    remedy = f'set estimator.wheels.model to "{wanted}", or leave it out of the bench file'
    yield Finding("bench", "calibration", level, found, f"estimator.wheels.model {wanted}", remedy)


def _examine_one(bench: Bench, device: Device, watch_s: float, sysfs: Path) -> Iterator[Finding]:
    told = list(_latency_timer(bench, device.name, sysfs))
    yield from told
    try:
        device.open()
    except HilError as error:
        yield _slowness_first(told, _failure(device, "open", error))
        return
    try:
        identity = ", ".join(f"{key} {value}" for key, value in device.identity().items())
        yield Finding(device.name, "open", "ok", identity)
        own = [f for f in getattr(device, "diagnose", tuple)() if f.check not in _SHOWN_BY_SAMPLES]
        told += own
        yield from own
        _watch(bench, device, _SETTLE_S)
        for finding in _LOOKS[device.name](bench, device, _watch(bench, device, watch_s), watch_s):
            yield _slowness_first(told, finding)
    except HilError as error:
        yield _slowness_first(told, _failure(device, "read", error))
    finally:
        device.close()


def _failure(device: Device, check: str, error: HilError) -> Finding:
    return Finding(device.name, check, "failure", error.message, error.expected, error.remedy)


def _slowness_first(told: list[Finding], finding: Finding) -> Finding:
    """A slow adapter makes all that is behind it look dead: that is to be mended first."""
    slow = [f.remedy for f in told if f.check in _SLOWNESS and f.level != "ok"]
    if not slow or finding.level != "failure" or finding.check not in _HURT_BY_SLOWNESS:
        return finding
    return replace(finding, remedy=f"{slow[-1]}; then look again")


def _watch(bench: Bench, device: Any, watch_s: float) -> list[Any]:
    """Everything read from a device at the loop rate."""
    samples: list[Any] = []
    period_ns = nanoseconds(1.0 / bench.config.loop.rate_hz)
    next_ns = bench.clock.now_ns()
    for _ in range(round(watch_s * bench.config.loop.rate_hz)):
        samples += device.read()
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)
    return samples


def _latency_timer(bench: Bench, name: str, sysfs: Path) -> Iterator[Finding]:
    """USB serial adapters as delivered wait 16 ms for more before they pass on what they hold."""
    config = getattr(bench.config, name)
    timer = latency_timer(getattr(config, "port", "none://"), sysfs)
    if timer is None or config.backend == "emulated":
        return
    try:
        found_s = int(timer.read_text()) / 1000.0
    except (OSError, ValueError):
        return
    level: Level = "ok" if found_s <= _LATENCY_TIMER_S else "warning"
    yield Finding(name, "latency timer", level, f"{found_s * 1e3:g} ms", "1 ms", f"echo 1 | sudo tee {timer}")


def _losses(name: str, statuses: list[Status], wanted: int, remedy: str) -> Iterator[Finding]:
    bad = Counter(s.value for s in statuses if s not in (Status.OK, Status.STARTING))
    good = sum(s is Status.OK for s in statuses)
    loss = 1.0 - good / wanted if wanted else 1.0
    level: Level = "failure" if loss > _LOSS_FAILURE else "warning" if loss > _LOSS_WARNING else "ok"
    told = ", ".join(f"{count} {kind}" for kind, count in bad.most_common()) or "no bad samples"
    yield Finding(name, "samples", level, f"{good} of {wanted} good ({told})", "nearly all good", remedy)


def _servos(bench: Bench, servos: Any, samples: list[Any], watch_s: float) -> Iterator[Finding]:
    wanted = round(watch_s * bench.config.loop.rate_hz)
    yield from _losses(
        "servos", [Status.OK if s.ok else next(x for x in s.status if x is not Status.OK) for s in samples],
        wanted, "check cables, termination and supply; lower the baud rate",
    )  # fmt: skip
    alerts = {SERVOS[i]: hardware_error_text(code) for s in samples for i, code in enumerate(s.alert) if code}
    yield Finding(
        "servos", "hardware errors", "failure" if alerts else "ok",
        ", ".join(f"{servo}: {error}" for servo, error in alerts.items()) or "none", "none",
        "remove the cause, then switch the servos' supply off and on",
    )  # fmt: skip
    yield from _health(bench, servos)


def _health(bench: Bench, servos: Any) -> Iterator[Finding]:
    bench.clock.sleep_until_ns(bench.clock.now_ns() + nanoseconds(bench.config.servos.health_period_s))  # type: ignore[union-attr]
    servos.read()
    found = servos.read_health()
    if not found:
        yield Finding("servos", "health", "warning", "voltage and temperature were not answered")
        return
    volts, celsius = found[-1].voltage_v, found[-1].temperature_c
    low, hot = np.nanmin(volts) < _LOW_SUPPLY_V, np.nanmax(celsius) > _HOT_C
    yield Finding(
        "servos", "supply", "warning" if low else "ok", f"{np.nanmin(volts):.1f} to {np.nanmax(volts):.1f} V",
        f"at least {_LOW_SUPPLY_V:g} V", "charge or replace the battery; check the wiring",
    )  # fmt: skip
    yield Finding(
        "servos", "temperature", "warning" if hot else "ok", f"up to {np.nanmax(celsius):.0f} C",
        f"below {_HOT_C:g} C", "let the servos cool; look for a jam",
    )  # fmt: skip


def _encoders(bench: Bench, encoders: Any, samples: list[Any], watch_s: float) -> Iterator[Finding]:
    config = bench.config.encoders
    assert config is not None
    link = Path("/sys/class/net") / config.channel / "operstate"
    down = config.interface == "socketcan" and link.exists() and link.read_text().strip() == "down"
    broken = encoders.bus_error or f"{config.channel} is down" * down
    level: Level = "failure" if broken else "warning" if encoders.error_frames else "ok"
    yield Finding(
        "encoders", "CAN state", level, broken or f"{encoders.error_frames} error frames", "no error frames",
        f"check bit rate ({config.bitrate}), termination (60 ohm) and wiring; "
        f"sudo ip link set {config.channel} up type can bitrate {config.bitrate} restart-ms 100",
    )  # fmt: skip
    rate_hz = config.rate_hz
    for i, wheel in enumerate(WHEELS):
        statuses = [s.status[i] for s in samples]
        for finding in _losses(
            "encoders", statuses, max(1, round(watch_s * rate_hz)), "check magnet distance and CAN wiring"
        ):
            yield Finding("encoders", f"{wheel} samples", finding.level, finding.found, finding.expected,
                          finding.remedy)  # fmt: skip


def _imu(bench: Bench, imu: Any, samples: list[Any], watch_s: float) -> Iterator[Finding]:
    wanted = round(watch_s * bench.config.loop.rate_hz)
    yield from _losses("imu", [s.status for s in samples], wanted, "check wiring and the 115200 baud link")
    good = [s for s in samples if s.status is Status.OK]
    if not good:
        return
    system, gyro, accelerometer, magnetometer = good[-1].calibration
    level: Level = "ok" if min(gyro, accelerometer) >= 2 else "warning"
    yield Finding(
        "imu", "calibration", level,
        f"system {system} gyro {gyro} accelerometer {accelerometer} magnetometer {magnetometer}",
        "gyro and accelerometer 2 or more", "hil run imu_calibration, or rest and tilt the robot",
    )  # fmt: skip
    norm = float(np.mean([np.linalg.norm(s.gravity_m_s2) for s in good]))
    level = "ok" if abs(norm - _GRAVITY_M_S2) < _GRAVITY_TOLERANCE_M_S2 else "failure"
    yield Finding(
        "imu", "gravity", level, f"{norm:.2f} m/s^2", f"{_GRAVITY_M_S2:.2f} m/s^2", "check the axis remap"
    )


def _tracker(bench: Bench, tracker: Any, samples: list[Any], watch_s: float) -> Iterator[Finding]:
    yield from _losses(
        "tracker", [s.status for s in samples], max(1, round(watch_s * 200.0)),
        "clean the lenses, light the scene, use a USB 3 port",
    )  # fmt: skip
    if samples:
        confidence = samples[-1].confidence
        yield Finding(
            "tracker", "confidence", "ok" if confidence >= 2 else "warning", f"{confidence} of 3",
            "2 or 3", "move the camera a little; the scene needs texture",
        )  # fmt: skip


def _mocap(bench: Bench, mocap: Any, samples: list[Any], watch_s: float) -> Iterator[Finding]:
    tracked = [s for s in samples if s.tracking_valid and s.status is Status.OK]
    share = len(tracked) / len(samples) if samples else 0.0
    now_ns = bench.clock.now_ns()
    seen_ns = [now_ns - nanoseconds(watch_s), *(s.stamp.host_ns for s in tracked), now_ns]
    gap_s = 1e-9 * max(b - a for a, b in pairwise(seen_ns))
    level: Level = "ok" if share > 1.0 - _LOSS_FAILURE and gap_s < _MOCAP_GAP_S else "failure"
    told = (
        f"{len(tracked)} of {len(samples)} frames, {len(samples) / watch_s:.0f} Hz, longest gap {gap_s:.2f} s"
    )
    yield Finding(
        "mocap", "tracking", level, told, f"nearly all frames tracked, gaps below {_MOCAP_GAP_S:g} s",
        "check markers, occlusion and the rigid body's definition",
    )  # fmt: skip
    if tracked:
        latency_s = float(np.median([s.latency_s for s in tracked]))
        late = not math.isfinite(latency_s) or latency_s > _LATE_MOCAP_S
        yield Finding(
            "mocap", "latency", "warning" if late else "ok", f"{latency_s * 1e3:.1f} ms",
            f"below {_LATE_MOCAP_S * 1e3:g} ms", "use a wired network",
        )  # fmt: skip


_LOOKS: dict[str, Callable[[Bench, Any, list[Any], float], Iterator[Finding]]] = {
    "servos": _servos,
    "encoders": _encoders,
    "imu": _imu,
    "tracker": _tracker,
    "mocap": _mocap,
}
