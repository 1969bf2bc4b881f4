"""Examines a bench without moving it: findings with remedies for each device.

Every device is opened separately, so that a missing one does not hide the others, and then read at the loop
rate for a while. The findings are data; `hil doctor` prints them.

Noise of gyro, camera and motion capture at rest is compared with the record. The mean NIS of a sensor at rest
is its variance divided by the variance that the estimator assumes; with the noise of the record it is 1 as
long as the sensor has not changed.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.bench.bench import Bench
from hil.bench.cross_checks.force import force_checks
from hil.bench.cross_checks.parameters import Parameters, advice, at_rest
from hil.bench.device_set_from_config import model_of
from hil.bench.doctor.inertial_offsets import inertial_changes
from hil.bench.doctor.port_findings import Host, host_findings
from hil.bench.doctor.steering_offsets import slipped_between
from hil.bench.loop_settings import wheel_model
from hil.bench.third_party.added_checks import checks_of
from hil.bench.third_party.sample_contract import find_contract_breaks
from hil.config.adhesion import AdhesionConfig
from hil.config.bench import BenchConfig
from hil.config.load_cells import LoadCellsConfig
from hil.config.robot_record.overlay import known_parts
from hil.core.clock import NS_PER_S, nanoseconds
from hil.core.errors import Aborted, HilError
from hil.core.finding import Finding, Level
from hil.core.interfaces import Device
from hil.core.registry import base_of, kinds
from hil.core.signals import Inputs, Measurements, Status, worst
from hil.core.third_party_errors import OURS, call_in_package
from hil.drivers.doctor_watch import Watched
from hil.estimator.noise_parameters import MEASURED, NoiseFigure
from hil.estimator.sample_statistics import DEAD_ZONE, Spread, about_a_line, blocks, total
from hil.estimator.tuning import value_of
from hil.links.serial_url import latency_timer
from hil.loop.alignment import Alignment

NOISIER, BETTER = 2.0, 0.5
"""Ratio of the standard deviation to the measured one beyond which a finding warns: twice, or half of it."""
_BLOCK_S = 0.2
_FEWEST = 30.0
_AT_REST = {one.name: one for one in MEASURED if one.state == "rest"}
_OF_POSES = {"tracker": "camera", "mocap": "mocap"}
"""Devices that measure poses, and the prefix of their figures."""
_REST_N, _FELT_N = 1.0, 5.0
_WATCH_S = 2.0
_SETTLE_S = 0.6
_LATENCY_TIMER_S = 0.001
_HERE = Host()
_SHOWN_BY_SAMPLES = ("hardware errors",)
_SLOWNESS, _HURT_BY_SLOWNESS = ("latency timer", "reply time"), ("open", "read", "samples")


def noise_at_rest(config: BenchConfig, measured: Measurements) -> Iterator[Finding]:
    """Findings on the sensors' noise; none on a device that delivered too few samples.

    Args:
        config: the bench configuration.
        measured: all aligned samples of a robot at rest.
    """
    for one, words, spread in _spreads(measured):
        if spread.freedom >= _FEWEST and one.device in config.devices():
            yield _finding(config, one, words, spread)


def _spreads(m: Measurements) -> Iterator[tuple[NoiseFigure, str, Spread]]:
    """Noise figures, their names in messages, and their variances."""
    rates = [(s.stamp.t_ns, s.yaw_rate_rad_s) for s in m.gyro if np.isfinite(s.yaw_rate_rad_s)]
    yield _AT_REST["gyro"], "gyro noise at rest", _white(rates, 1)
    for device, begins in _OF_POSES.items():
        poses = [(s.stamp.t_ns, *s.pose) for s in getattr(m, device) if s.valid]
        place = _white(poses, 1) + _white(poses, 2)
        yield _AT_REST[f"{begins}_position"], "position noise at rest", place
        yield _AT_REST[f"{begins}_heading"], "heading noise at rest", _white(poses, 3)


def _white(rows: Sequence[tuple[float, ...]], column: int) -> Spread:
    if len(rows) < 3:
        return Spread()
    t_s = 1e-9 * np.array([row[0] - rows[0][0] for row in rows], dtype=np.float64)
    values = np.array([row[column] for row in rows], dtype=np.float64)
    return total(about_a_line(t_s[part], values[part]) for part in blocks(t_s, _BLOCK_S))


def _finding(config: BenchConfig, one: NoiseFigure, words: str, spread: Spread) -> Finding:
    taken = value_of(config.estimator, one.key)
    part = known_parts(config).get("noise")
    kept = None if part is None else part.figures.get(one.label)
    sigma = spread.sigma()[0]
    if sigma == 0.0 and one.device == "imu":
        return Finding(one.device, words, "warning", DEAD_ZONE, "some noise", "hil run sensor_noise")
    found = f"{one.per_si * sigma:.3g} {one.unit}, mean NIS {spread.variance / taken**2:.2g}"
    if kept is None or part is None or kept.value <= 0.0:
        expected = f"the estimator takes {one.per_si * taken:.3g} {one.unit}, not measured"
        level: Level = "warning" if sigma > NOISIER * taken else "ok"
        return Finding(one.device, words, level, found, expected, "hil run sensor_noise measures it")
    ratio = sigma / kept.value
    if not BETTER <= ratio <= NOISIER:
        found += f": {'noisier' if ratio > 1.0 else 'better'} than its record, {ratio:.2g} times"
    expected = f"{BETTER:g} to {NOISIER:g} times the {one.per_si * kept.value:.3g} {one.unit} of its record"
    level = "warning" if ratio > NOISIER else "ok"
    return Finding(
        one.device,
        words,
        level,
        found,
        f"{expected} ({part.measured[:10]})",
        "look at what shakes or dazzles it; if it stays, measure it again: hil run sensor_noise",
    )


def unexplained_force(config: BenchConfig, seen: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """Compare the force by load cells with a fan at rest; only deviations are reported.

    This detects a cell zero that has changed since `adhesion_check`.

    Args:
        config: the bench configuration.
        seen: samples of every kind that was watched.
    """
    fan, cells = config.of(AdhesionConfig), config.of(LoadCellsConfig)
    speeds_rpm = [s.speed_rpm for s in seen.get("adhesion", ()) if s.status is Status.OK]
    forces_n = [s.force_n for s in seen.get("load_cells", ()) if worst(s) is Status.OK]
    if fan is None or cells is None or not speeds_rpm or not forces_n:
        return
    speed_rpm = float(np.max(np.abs(speeds_rpm)))
    felt_n = float(np.sum(np.mean(forces_n, axis=0) - np.array(cells.zero_n)))
    made_n = fan.force_at_n(float(np.mean(np.abs(speeds_rpm))))
    if made_n > _REST_N or felt_n < _FELT_N:
        return
    yield Finding(
        "load_cells",
        "force without fan",
        "warning",
        f"the cells feel {felt_n:.1f} N, and the fan is at rest ({speed_rpm:.0f} 1/min)",
        f"at most {_FELT_N:g} N while the fan is at rest",
        "if a tether or a hand presses the robot on, start the fan before you let go (hil adhesion on); "
        "if nothing does, find the zero of the cells (hil run adhesion_check); "
        "if the fan turns, check its status message 1",
    )


def contradictions(parameters: Parameters) -> Iterator[Finding]:
    """A failure for each contradiction of the bench file; those that are told alike are one."""
    told = set[str]()
    for check in parameters.contradicted().values():
        if check.text not in told:
            told.add(check.text)
            table, _, key = check.key.partition(".")
            yield Finding(table, key, "failure", check.text, "what the bench file says", advice(check))


def examine(bench: Bench, *, watch_s: float = _WATCH_S, host: Host = _HERE) -> Iterator[Finding]:
    """Findings about the computer, the calibration and every device of a bench.

    Args:
        bench: result of `open_bench`, not entered; its devices are opened and closed here.
        watch_s: time for which each device is read, s.
        host: folders in which the kernel describes this machine.

    Raises:
        Aborted: a person or a signal ended the examination.
    """
    seen: dict[str, list[Any]] = {}
    try:
        yield from host_findings(bench.config, host)
        bench.begin()
        yield from _calibration(bench)
        for name in dict.fromkeys((*bench.devices.sensors, *bench.config.devices())):
            kind = base_of(name)
            for found in _examine_one(bench, name, watch_s, host, seen):
                yield replace(found, device=name) if found.device == kind else found
        yield from unexplained_force(bench.config, seen)
        bench.parameters.take((*at_rest(bench.config, seen), *force_checks(bench.config, seen)))
        yield from contradictions(bench.parameters)
        yield from slipped_between(bench.config, seen)
        measured = _aligned(bench, seen)
        yield from inertial_changes(bench.config, (measured,))
        yield from noise_at_rest(bench.config, measured)
    finally:
        bench.close()


def _aligned(bench: Bench, seen: Mapping[str, Sequence[Any]]) -> Measurements:
    """Align the samples of IMU, camera and motion capture as if of one cycle."""
    samples: dict[str, Any] = {name: tuple(seen.get(name, ())) for name in ("imu", "tracker", "mocap")}
    return Alignment(bench.model.alignment_parameters).measure(Inputs(0, 0, **samples))


def _calibration(bench: Bench) -> Iterator[Finding]:
    """Finding whether the estimator uses the wheel model that the calibration was fitted with."""
    if not bench.calibration:
        return
    used, wanted = bench.config.estimator.wheels.model, wheel_model(bench.model.fitted_with)
    level: Level = "ok" if used == wanted else "warning"
    found = f"{bench.calibration}, fitted with the {bench.model.fitted_with} model; estimated with {used}"
    remedy = f'set estimator.wheels.model to "{wanted}", or leave it out of the bench file'
    yield Finding("bench", "calibration", level, found, f"estimator.wheels.model {wanted}", remedy)


def _examine_one(
    bench: Bench, kind: str, watch_s: float, host: Host, seen: dict[str, list[Any]]
) -> Iterator[Finding]:
    """Findings about one device; `seen` receives its samples."""
    device = bench.devices.get(kind)
    reported = list(_latency_timer(bench, kind, host))
    yield from reported
    try:
        device.open()
    except Aborted:
        raise  # a stop from outside is not a fault of the device
    except HilError as error:
        yield _slowness_first(reported, _failure(device, "open", error))
        return
    try:
        identity = ", ".join(f"{key} {value}" for key, value in device.identity().items())
        yield Finding(device.name, "open", "ok", identity)
        own = [f for f in getattr(device, "diagnose", tuple)() if f.check not in _SHOWN_BY_SAMPLES]
        reported += own
        yield from own
        _watch(bench, device, _SETTLE_S, [])
        for finding in _looks(bench, kind, device, watch_s, seen):
            yield _slowness_first(reported, finding)
    except Aborted:
        raise
    except HilError as error:
        yield _slowness_first(reported, _failure(device, "read", error))
    finally:
        device.close()


def _looks(
    bench: Bench, name: str, device: Any, watch_s: float, seen: dict[str, list[Any]]
) -> Iterator[Finding]:
    """Findings by the checks of kind and model after a device was read for a while."""
    kind, model, config = kinds()[name], model_of(bench.config, name), bench.config.devices()[name]
    waits_s: list[float] = []
    samples = seen[name] = _watch(bench, device, watch_s, waits_s)
    watched = Watched(kind, config, device, samples, watch_s, bench.clock, bench.config.loop.rate_hz)
    if model.package != OURS:
        yield from find_contract_breaks(watched, waits_s)
    package = model.package if kind.package == OURS else kind.package
    yield from call_in_package(name, package, "its check or rate_hz", lambda: list(kind.check(watched)))
    yield from call_in_package(name, model.package, "its check", lambda: list(model.check(watched)))
    checks_of(bench.config, name)


def _failure(device: Device, check: str, error: HilError) -> Finding:
    return Finding.of_error(device.name, check, error)


def _slowness_first(earlier: list[Finding], finding: Finding) -> Finding:
    """Put the remedy for a slow adapter first: with it every device behind it seems dead."""
    slow = [f.remedy for f in earlier if f.check in _SLOWNESS and f.level != "ok"]
    if not slow or finding.level != "failure" or finding.check not in _HURT_BY_SLOWNESS:
        return finding
    return replace(finding, remedy=f"{slow[-1]}; then look again")


def _watch(bench: Bench, device: Any, watch_s: float, waits_s: list[float]) -> list[Any]:
    """Read a device at the loop rate and return all samples; `waits_s` receives each read's duration."""
    samples: list[Any] = []
    period_ns = nanoseconds(1.0 / bench.config.loop.rate_hz)
    next_ns = bench.clock.now_ns()
    for _ in range(round(watch_s * bench.config.loop.rate_hz)):
        began_ns, began_s = bench.clock.now_ns(), time.perf_counter()
        samples += device.read()
        waits_s.append(max((bench.clock.now_ns() - began_ns) / NS_PER_S, time.perf_counter() - began_s))
        next_ns += period_ns
        bench.clock.sleep_until_ns(next_ns)
    return samples


def _latency_timer(bench: Bench, name: str, host: Host) -> Iterator[Finding]:
    """Finding on the latency timer of a USB serial adapter: by default data are delayed by up to 16 ms."""
    config = bench.config.devices()[name]
    port = getattr(config, "port", None)
    timer = latency_timer(port, host.sysfs) if isinstance(port, str) else None
    if timer is None or config.backend == "emulated":
        return
    try:
        found_s = int(timer.read_text()) / 1000.0
    except (OSError, ValueError):
        return
    level: Level = "ok" if found_s <= _LATENCY_TIMER_S else "warning"
    yield Finding(name, "latency timer", level, f"{found_s * 1e3:g} ms", "1 ms", f"echo 1 | sudo tee {timer}")
