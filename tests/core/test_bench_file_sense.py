"""Limits that make no sense are refused: on the command line, in a file and in Python, all at once."""

import math
import re

import pytest

import hil
from hil.config.loading import load_bench
from hil.config.unchecked import recorded_bench
from hil.core.errors import ConfigError
from hil.procedure.bench_source import BenchSource


def refused(**overrides):
    with pytest.raises(ConfigError) as error:
        load_bench("emulated", overrides={k.replace("__", "."): v for k, v in overrides.items()})
    return error.value.problems


@pytest.mark.parametrize("zero_rad", [0.53, -0.53, 1.0])
def test_a_zero_that_leaves_a_wheel_less_than_its_range_is_refused(zero_rad):
    zeros = [0.0, 0.1, zero_rad, -0.1]
    (problem,) = refused(alignment__steer_zero_rad=zeros)
    assert "BR's zero" in problem
    assert f"leaves {2.618 - abs(zero_rad):.4g}" in problem
    narrower = {"safety.steering_limit_rad": 1.61, "control.steering_limit_rad": 1.61}
    if abs(zero_rad) <= 1.0:
        load_bench("emulated", overrides={"alignment.steer_zero_rad": zeros, **narrower})
    zeros[2] = 0.52 * zero_rad / abs(zero_rad)
    load_bench("emulated", overrides={"alignment.steer_zero_rad": zeros})


@pytest.mark.parametrize(
    ("path", "value", "reported"),
    [
        ("safety.wheel_rate_limit_rad_s", 7.5, "XH430"),
        ("encoders.port", 43113, "belongs to [encoders.options]"),
        ("safety.steering_limit_rad", 2.7, "servos.steer_limit_rad = 2.618"),
        ("safety.wheel_rate_limit_rad_s", 6.0, "servos.velocity_limit_rad_s = 4.9"),
        ("control.steering_limit_rad", 2.2, "safety.steering_limit_rad = 2.0944"),
        ("control.wheel_speed_m_s", 0.2, "0.178 m/s of the largest wheel"),
        ("safety.heading_limit_rad", 0.9, "slides"),
        ("safety.adhesion_limit_m_s2", 0.0, "no fall would be noticed"),
        ("loop.rate_hz", 10.0, "trip between cycles"),
        ("environment.x_range_m", [1.0, -1.0], "before it begins"),
        ("load_cells.n_per_count.0", [0.0, 5e-5], "in size at least 1e-07: N per count"),
        ("load_cells.zero_n", [1000.0, 1000.0], "at most half of the range (largest_n = 392), 196 N"),
        ("adhesion.timeout_s", 0.0, "at 0 the motor would run for ever"),
    ],
)
def test_a_limit_says_what_it_would_take(path, value, reported):
    (problem,) = refused(**{re.sub(r"\.\d+$", "", path): value})
    assert problem.startswith(f"{path}: ")
    assert reported in problem


@pytest.mark.parametrize(
    ("overrides", "paths"),
    [
        ({"adhesion.own_id": 1}, ["adhesion.own_id: VESC id 1 is that of adhesion.controller_id"]),
        (
            {"adhesion.controller_id": 3},
            ["thrust.controller_ids: VESC id 3 is that of adhesion.controller_id"],
        ),
        ({"thrust.own_id": 2}, ["thrust.own_id: VESC id 2 is that of thrust.controller_ids"]),
        (
            {"thrust.own_id": 1, "adhesion.own_id": 3},
            [
                "thrust.own_id: VESC id 1 is that of adhesion.controller_id",
                "thrust.controller_ids: VESC id 3 is that of adhesion.own_id",
            ],
        ),
        ({"encoders.node_id": 15}, ["load_cells.node_id: frame 432 is that of encoders.node_id"]),
        ({"encoders.bitrate": 250_000}, ["adhesion.bitrate: 500000, but encoders.bitrate = 250000"]),
        ({"adhesion.model": "dronecan", "adhesion.own_id": 42}, ["adhesion.own_id: DroneCAN node 42"]),
    ],
)
def test_who_shares_a_bus_shares_no_identifier_and_its_bit_rate(overrides, paths, tmp_path):
    """Everything that quarrels is reported; what is on a bus of its own may be called as it likes."""
    path = tmp_path / "bench.toml"
    tables = '[adhesion]\n[thrust]\nmodel = "vesc"\n[load_cells]\nmodel = "hx711_can"\n[encoders]\n'
    path.write_text(f'schema = 1\nname = "one bus"\n{tables}', encoding="utf-8")
    load_bench(str(path))
    with pytest.raises(ConfigError) as caught:
        load_bench(str(path), overrides=overrides)
    problems = caught.value.problems
    assert all(any(problem.startswith(start) for problem in problems) for start in paths), problems
    assert caught.value.exit_code == 2
    apart = {"thrust.channel": "can1", "load_cells.channel": "can2", "encoders.channel": "can3"}
    own = {key: value for key, value in overrides.items() if key not in ("adhesion.own_id", "thrust.own_id")}
    load_bench(str(path), overrides={**own, **apart})


@pytest.mark.parametrize("watchdog_s", [0.0, 0.12])
def test_on_a_wall_the_watchdog_stops_the_wheels_within_a_tenth_of_a_second(watchdog_s):
    (problem,) = refused(**{"servos.watchdog_s": watchdog_s})
    assert problem.startswith("servos.watchdog_s: ")
    assert load_bench("emulated").servos.watchdog_s == 0.08
    assert load_bench("emulated_floor", overrides={"servos.watchdog_s": watchdog_s}).servos is not None


def test_every_senseless_limit_is_reported_at_once_also_beside_a_contradiction():
    problems = refused(
        safety__wheel_rate_limit_rad_s=1e9,
        safety__tracking_error_limit_m=math.inf,
        servos__watchdog_s=0.0,
        servos__velocity_limit_rad_s=1e9,
        loop__speed_hz=3.0,
        safety__heading_limit_rad=1.0,
    )
    assert sorted(p.partition(":")[0] for p in problems) == [
        "loop.speed_hz",
        "safety.heading_limit_rad",
        "safety.tracking_error_limit_m",
        "safety.wheel_rate_limit_rad_s",
        "servos.velocity_limit_rad_s",
        "servos.watchdog_s",
    ]


def test_a_robot_on_a_rope_may_be_turned_until_it_slides():
    limit = {"safety.heading_limit_rad": math.pi / 2, "safety.tethered": True}
    assert load_bench("emulated", overrides=limit).safety.tethered
    stronger = {"safety.heading_limit_rad": 0.9, "robot.edf_force_n": 90.0}
    assert load_bench("emulated", overrides=stronger).robot.hold_limit_rad() > 0.9
    assert load_bench("emulated").robot.hold_limit_rad() == pytest.approx(math.radians(39.0), abs=0.01)


def test_python_is_refused_the_same():
    for limits in ({"servos.watchdog_s": 0.0}, {"control.wheel_speed_m_s": 1e9}):
        with pytest.raises(ConfigError, match=next(iter(limits))):
            hil.open_bench("emulated", overrides=limits)
        with pytest.raises(ConfigError, match=next(iter(limits))):
            _ = BenchSource("emulated", overrides=limits).config
    config = load_bench("emulated")
    slow = config.model_copy(update={"servos": config.servos.model_copy(update={"watchdog_s": 0.0})})
    with pytest.raises(ConfigError, match=r"servos\.watchdog_s"):
        hil.open_bench(slow)


def test_what_was_recorded_stays_readable_whatever_would_be_refused_today():
    tree = load_bench("emulated").model_dump(mode="json", by_alias=True, exclude_none=True)
    tree["servos"]["watchdog_s"] = 0.2
    tree["safety"] |= {"heading_limit_rad": 1.5707963267948966, "tracking_error_limit_m": math.inf}
    config = recorded_bench(tree, "old.mcap")
    assert (config.servos.watchdog_s, config.safety.tracking_error_limit_m) == (0.2, math.inf)
    with pytest.raises(ConfigError, match=r"(?s)old\.mcap: 1 problem.*safety\.whim: unknown key"):
        recorded_bench({**tree, "safety": {"whim": 1.0}}, "old.mcap")


PORTS = (
    '[servos]\nport = "{dev}/usb0"\n[imu]\nport = "{dev}/usb1"\n[thrust]\nmodel = "teensy"\n'
    'port = "{dev}/acm0"\n[load_cells]\nmodel = "hx711_line"\nport = "{dev}/acm0"\n'
    '[encoders]\ninterface = "slcan"\nchannel = "{dev}/acm1@115200"\n'
)


@pytest.mark.parametrize(
    ("key", "port", "reported"),
    [
        ("thrust.port", "usb0", "thrust.port: '{dev}/usb0' is the port of servos.port = '{dev}/usb0', too"),
        ("imu.port", "by-id", "imu.port: '{dev}/by-id' is the port of servos.port = '{dev}/usb0', too"),
        ("imu.port", "../dev/usb0", "imu.port: '{dev}/../dev/usb0' is the port of servos.port"),
        ("load_cells.port", "usb0", "load_cells.port: '{dev}/usb0' is the port of servos.port"),
        ("servos.port", "acm0", "load_cells.port: '{dev}/acm0' is the port of servos.port"),
        ("encoders.channel", "usb1@115200", "imu.port: '{dev}/usb1' is the port of encoders.channel"),
    ],
)
def test_no_two_devices_have_one_serial_port_but_cells_and_propellers_of_one_teensy(
    key, port, reported, tmp_path
):
    dev = tmp_path / "dev"
    dev.mkdir()
    (dev / "usb0").touch()
    (dev / "by-id").symlink_to(dev / "usb0")
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = 1\nname = "ports"\n{PORTS.format(dev=dev)}', encoding="utf-8")
    assert load_bench(str(path)).devices()
    with pytest.raises(ConfigError) as caught:
        load_bench(str(path), overrides={key: f"{dev}/{port}"})
    assert any(problem.startswith(reported.format(dev=dev)) for problem in caught.value.problems)
    kind = key.partition(".")[0]
    load_bench(str(path), overrides={key: f"{dev}/{port}", f"{kind}.backend": "emulated"})


def test_remote_ports_count_by_their_address(tmp_path):
    path = tmp_path / "bench.toml"
    tables = '[servos]\nport = "socket://10.0.0.2:4000"\n[imu]\nport = "socket://10.0.0.2:4001"\n'
    path.write_text(f'schema = 1\nname = "remote"\n{tables}', encoding="utf-8")
    load_bench(str(path))
    load_bench(str(path), overrides={"servos.port": "loop://", "imu.port": "loop://"})
    with pytest.raises(ConfigError, match=r"is the port of servos\.port"):
        load_bench(str(path), overrides={"imu.port": "socket://10.0.0.2:4000"})


@pytest.mark.parametrize(
    ("tables", "readers"),
    [
        (("encoders", "load_cells"), "encoders, load_cells"),
        (("adhesion",), "adhesion, the daemon of adhesion"),
        (("encoders",), ""),
    ],
)
@pytest.mark.parametrize("interface", ["slcan", "gs_usb", "socketcan"])
def test_an_adapter_for_one_reader_is_not_shared(tables, readers, interface, tmp_path):
    """Each of two readers of a serial port gets some of the bytes: both lose frames, and cut others short."""
    path, port = tmp_path / "bench.toml", tmp_path / "acm0"
    channels = iter((str(port), f"{port}@115200"))
    port.touch()
    where = "".join(f'[{name}]\ninterface = "{interface}"\nchannel = "{next(channels)}"\n' for name in tables)
    path.write_text(f'schema = 1\nname = "shared"\n{where}', encoding="utf-8")
    if not readers or interface == "socketcan":
        assert load_bench(str(path)).devices()
        return
    with pytest.raises(ConfigError, match=rf"{tables[0]}\.interface: '{interface}'.*{readers}.*slcand"):
        load_bench(str(path))
