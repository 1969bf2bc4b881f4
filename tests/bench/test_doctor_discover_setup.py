"""`hil doctor`, `hil discover` and `hil setup` against emulated devices, in process and at the wire."""

import json
import re
import shlex
from functools import partial
from itertools import pairwise

import pytest

import hil
from hil.bench.doctor.discovery import Discovery, discover
from hil.bench.doctor.examination import examine
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.signals import KINDS
from hil.drivers.servos.dynamixel.commissioning import scan
from hil.fakes.world import VirtualClock

pytestmark = pytest.mark.usefixtures("warm_commands")

SETTLE_S = 0.6


def doctor(capsys, *options):
    code = main(["doctor", "--json", "--watch", "0.5", *options])
    return code, json.loads(capsys.readouterr().out)


def levels(result):
    return {(f["device"], f["check"]): f["level"] for f in result["findings"]}


@pytest.mark.parametrize("way", [(), ("--realtime",)], ids=["virtual", "wire"])
def test_the_emulated_bench_is_healthy(capsys, way):
    code, result = doctor(capsys, *way)
    assert [f for f in result["findings"] if f["level"] == "failure"] == []
    assert (code, result["ok"]) == (0, True)
    assert {f["device"] for f in result["findings"]} == set(KINDS)


@pytest.mark.parametrize(
    ("fault", "device"),
    [
        ("imu:off", "imu"),
        ("mocap:off", "mocap"),
        ("encoders:bus_off", "encoders"),
        ("servo.drive_BL:off", "servos"),
        ("adhesion:off", "adhesion"),
    ],
)
def test_a_sick_device_is_named_and_does_not_hide_the_others(capsys, fault, device):
    code, result = doctor(capsys, "--fault", fault)
    assert code == 3
    assert {sick for (sick, _), level in levels(result).items() if level == "failure"} == {device}
    assert {f["device"] for f in result["findings"]} == set(KINDS)
    failed = [f for f in result["findings"] if f["level"] == "failure"]
    assert all(f["found"] for f in failed)
    assert any(f["remedy"] for f in failed)


@pytest.mark.parametrize(
    ("start", "faults", "reported"),
    [("tethered", (), True), ("tethered", ("load_cells:wrong,factor=0.05",), False), ("running", (), False)],
)
def test_a_force_that_no_fan_makes_is_reported_with_both_and_what_to_do(start, faults, reported):
    bench = hil.open_bench("emulated", faults=faults, overrides={"emulation.adhesion.start": start})
    found = [f for f in examine(bench, watch_s=0.5) if f.check == "force without fan"]
    assert len(found) == reported
    assert all(re.match(r"the cells feel 45\.\d N", f.found) for f in found)


@pytest.fixture(scope="module")
def opened_at_s():
    """When each device has been opened and settled in a doctor's run of half a second each."""
    bench, times = hil.open_bench("emulated"), {}
    for finding in examine(bench, watch_s=0.5):
        if finding.check == "open":
            times[finding.device] = bench.clock.now_ns() * 1e-9 + SETTLE_S
    return times


@pytest.mark.parametrize(
    ("device", "kind", "options", "check"),
    [
        ("imu", "garbage", "", "samples"),
        ("mocap", "off", "", "tracking"),
        ("servos", "drop", ",probability=0.5", "samples"),
        ("tracker", "off", "", "samples"),
    ],
)
def test_a_device_that_falls_ill_while_it_is_read_is_named(capsys, opened_at_s, device, kind, options, check):
    fault = f"{device}:{kind}@{opened_at_s[device]}{options}"
    code, result = doctor(capsys, "--fault", fault)
    assert code == 3
    assert levels(result)[device, check] == "failure"
    assert {sick for (sick, _), level in levels(result).items() if level == "failure"} == {device}


def test_an_ill_can_bus_is_distinguished_from_an_ill_node(capsys, opened_at_s):
    _, result = doctor(capsys, "--fault", f"encoders:bus_off@{opened_at_s['encoders']}")
    seen = levels(result)
    assert (seen["encoders", "CAN state"], seen["encoders", "FL samples"]) == ("warning", "failure")


def findings_with(tmp_path, text):
    """Of the emulated servos alone, with these keys in the bench file."""
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = 1\nname = "servos"\n[servos]\nbackend = "emulated"\n{text}')
    return {f.check: f for f in examine(hil.open_bench(path), watch_s=0.5)}


def test_a_return_delay_is_taken_away_by_the_command_that_doctor_prints(tmp_path, emulator, capsys):
    found = findings_with(tmp_path, "[emulation.servos]\nreturn_delay = 250\n")["return delay"]
    assert (found.level, found.found) == ("warning", "up to 500 us")
    assert found.remedy.endswith(", and for ID 2, 3, 4, 5, 6, 7, 8")
    words = shlex.split(found.remedy.split("`")[1])
    assert words[:2] == ["hil", "setup"]
    where = {"--port": emulator["servos"]["port"], "--baud": str(emulator["servos"]["baud"])}
    words = [where.get(before, word) for before, word in pairwise(words)]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["registers"]["return_delay_time"][1] == 0


def test_a_hardware_error_is_reported_in_words(tmp_path):
    found = findings_with(tmp_path, "[emulation.servos]\nsupply_v = 9.0\n")["hardware errors"]
    assert found.level == "failure"
    assert "drive_FL: input voltage" in found.found


@pytest.mark.parametrize(
    ("models", "reported"),
    [
        (dict.fromkeys("01234567", 1000), "model_number = 1000"),
        ({"3": 1050}, "# servos of model 1010 (XH430-W210), 1050 (XH430-V210) at"),
    ],
)
def test_discover_writes_the_model_down_or_says_that_it_is_not_known(models, reported):
    config = load_bench(
        "emulated",
        overrides=dict.fromkeys(("encoders", "imu", "tracker", "mocap"))
        | {"emulation.servos.model_by_joint": models},
    )
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    port = connected.connections["servos"].values["port"]
    said = []
    assert reported in discover(VirtualClock(world), ports=[port], say=said.append).to_toml()
    assert said[:2] == [f"asking {port}", f"found Dynamixel X servos on RS-485 or TTL at {port}"]
    connected.close()


@pytest.mark.parametrize(
    "rates", [pytest.param("all", marks=pytest.mark.long), "two"], ids="servos asked at {} baud rates".format
)
def test_discover_finds_everything_and_its_file_opens_a_healthy_bench(
    emulator, capsys, tmp_path, monkeypatch, rates
):
    if rates == "two":
        bauds = (57_600, emulator["servos"]["baud"])
        monkeypatch.setattr("hil.drivers.servos.dynamixel.commissioning.scan", partial(scan, bauds=bauds))
    file, can = tmp_path / "found.toml", emulator["can"]
    ports = ["--port", emulator["imu"]["port"], "--port", emulator["servos"]["port"]]
    others = ["--can", f"{can['interface']}:{can['channel']}:{can['port']}"]
    others += ["--mocap", f"127.0.0.1:{emulator['mocap']['command_port']}"]
    assert main(["discover", "--on-stand", *ports, *others, "--out", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [s["servo_id"] for s in found["servos"]] == list(range(1, 9))
    assert {s["baud"] for s in found["servos"]} == {emulator["servos"]["baud"]}
    assert tuple(load_bench(file).devices()) == ("servos", "encoders", "imu", "mocap")
    code, result = doctor(capsys, "--bench", str(file))
    assert [f for f in result["findings"] if f["level"] == "failure"] == []
    assert code == 0
    assert main(["discover", "--out", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_discover_names_a_port_at_which_nothing_answered_beside_one_where_something_did(monkeypatch, capsys):
    answered = Discovery(sections={"imu": {"port": "chip://imu"}}, silent=["chip://nope"])
    monkeypatch.setattr("hil.bench.doctor.discovery.discover", lambda *_, **__: answered)
    assert main(["discover", "--on-stand", "--port", "chip://imu", "--port", "chip://nope"]) == 3
    said = capsys.readouterr()
    assert "hil: nothing answered at chip://nope; check its name, power and cable" in said.err
    assert "[imu]" in said.out


def test_discover_without_an_answer_and_with_nonsense(capsys, tmp_path):
    out = tmp_path / "found.toml"
    assert main(["discover", "--port", str(tmp_path / "no-port"), "--out", str(out), "--json"]) == 3
    said = capsys.readouterr().err
    assert "nothing answered" in said
    assert f"not asked: {tmp_path / 'no-port'}: port cannot be opened" in said
    assert not out.exists()
    assert main(["discover", "--can", "can0"]) == 2
    assert main(["discover", "--mocap", "somewhere"]) == 2
    assert "IPv4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("place", "reported"),
    [
        ("imu.port=x", "kinds are encoders"),
        ("tracker", "KIND.KEY=VALUE"),
        ("tracker.model=none", "one of t265, mavlink"),
        ("mocap.sever=x", "command_port"),
    ],
)
def test_discover_names_what_is_wrong_with_a_place(place, reported, capsys):
    assert main(["discover", "--at", place]) == 2
    assert reported in capsys.readouterr().err


def test_setup_renames_a_servo_and_changes_its_baud_rate(emulator, capsys):
    port, baud = emulator["servos"]["port"], emulator["servos"]["baud"]

    def setup(*options):
        code = main(["setup", "--json", "--port", port, *options])
        caught = capsys.readouterr()
        return code, json.loads(caught.out)["registers"] if code == 0 else caught.err

    assert setup("--baud", str(baud), "--id", "8", "--new-id", "20")[1]["id"] == [8, 20]
    code, changed = setup("--baud", str(baud), "--id", "20", "--new-baud", "57600", "--role", "drive")
    assert code == 0
    assert changed["operating_mode"][1] == 1
    code, back = setup("--id", "20", "--new-id", "8", "--new-baud", str(baud), "--role", "steer")
    assert code == 0
    assert back["id"] == [20, 8]
    assert setup("--baud", str(baud), "--id", "8", "--new-id", "1")[0] == 3
    code, reported = setup("--baud", str(baud), "--id", "8", "--register", "goal_velocity=3")
    assert code == 2
    assert "goal_velocity" in reported
    assert setup("--baud", str(baud), "--id", "8", "--register", "shutdown=banana")[0] == 2
    assert setup("--baud", str(baud), "--id", "77")[0] == 3
