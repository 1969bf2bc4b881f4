"""`hil doctor`, `hil discover` and `hil setup` against emulated devices, in process and at the wire."""

import json

import pytest

import hil
from hil.bench.doctor import examine
from hil.cli import main
from hil.config.bench import load_bench


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
    assert {f["device"] for f in result["findings"]} == {"servos", "encoders", "imu", "tracker", "mocap"}


@pytest.mark.parametrize(
    ("fault", "device"),
    [
        ("imu:off", "imu"),
        ("mocap:off", "mocap"),
        ("tracker:off", "tracker"),
        ("encoders:bus_off", "encoders"),
        ("servo.drive_BL:off", "servos"),
    ],
)
def test_a_sick_device_is_named_and_does_not_hide_the_others(capsys, fault, device):
    code, result = doctor(capsys, "--fault", fault)
    assert code == 3
    assert {sick for (sick, _), level in levels(result).items() if level == "failure"} == {device}
    assert {f["device"] for f in result["findings"]} == {"servos", "encoders", "imu", "tracker", "mocap"}
    failed = [f for f in result["findings"] if f["level"] == "failure"]
    assert all(f["found"] for f in failed)
    assert any(f["remedy"] for f in failed)


@pytest.fixture(scope="module")
def opened_at_s():
    """When each device has been opened and settled in a doctor's run of half a second each."""
    bench, times = hil.open_bench("emulated"), {}
    for finding in examine(bench, watch_s=0.5):
        times.setdefault(finding.device, bench.clock.now_ns() * 1e-9)
    return times


@pytest.mark.parametrize(
    ("device", "kind", "check"),
    [
        ("imu", "garbage", "samples"),
        ("mocap", "off", "tracking"),
        ("tracker", "off", "samples"),
        ("encoders", "bus_off", "FL samples"),
        ("servos", "drop", "samples"),
    ],
)
def test_a_device_that_falls_ill_while_it_is_read_is_named(capsys, opened_at_s, device, kind, check):
    fault = f"{device}:{kind}@{opened_at_s[device]}"
    code, result = doctor(capsys, "--fault", fault)
    assert code == 3
    assert levels(result)[device, check] == "failure"
    assert {sick for (sick, _), level in levels(result).items() if level == "failure"} == {device}


def test_an_ill_can_bus_is_told_from_an_ill_node(capsys, opened_at_s):
    _, result = doctor(capsys, "--fault", f"encoders:bus_off@{opened_at_s['encoders']}")
    state = next(f for f in result["findings"] if f["check"] == "CAN state")
    assert state["level"] == "warning"
    assert state["found"] == "1 error frames"
    assert "ip link set" in state["remedy"]


def test_what_a_person_reads_has_a_remedy(capsys):
    assert main(["doctor", "--watch", "0.5", "--fault", "servo.steer_FR:off"]) == 3
    out = capsys.readouterr().out
    assert "FAIL servos" in out
    assert "expected" in out


def test_discover_finds_everything_and_its_file_opens_a_healthy_bench(emulator, capsys, tmp_path):
    file, can = tmp_path / "found.toml", emulator["can"]
    ports = ["--port", emulator["imu"]["port"], "--port", emulator["servos"]["port"]]
    others = ["--can", f"{can['interface']}:{can['channel']}:{can['port']}"]
    others += ["--mocap", f"127.0.0.1:{emulator['mocap']['command_port']}"]
    assert main(["discover", *ports, *others, "--out", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [s["servo_id"] for s in found["servos"]] == list(range(1, 9))
    assert {s["baud"] for s in found["servos"]} == {emulator["servos"]["baud"]}
    assert tuple(load_bench(file).devices()) == ("servos", "encoders", "imu", "mocap")
    code, result = doctor(capsys, "--bench", str(file))
    assert [f for f in result["findings"] if f["level"] == "failure"] == []
    assert code == 0
    assert main(["discover", "--out", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_discover_without_an_answer_and_with_nonsense(capsys, tmp_path):
    assert main(["discover", "--port", str(tmp_path / "no-port")]) == 3
    assert "nothing answered" in capsys.readouterr().err
    assert main(["discover", "--can", "can0"]) == 2
    assert main(["discover", "--mocap", "somewhere"]) == 2
    assert "IPv4" in capsys.readouterr().err


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
    code, told = setup("--baud", str(baud), "--id", "8", "--register", "goal_velocity=3")
    assert code == 2
    assert "goal_velocity" in told
    assert setup("--baud", str(baud), "--id", "8", "--register", "shutdown=banana")[0] == 2
    assert setup("--baud", str(baud), "--id", "77")[0] == 3
