"""`hil adhesion`: on, off, status, watch and keep, at an emulated VESC and at a fan on the wire."""

import configparser
import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kills import daemon_pid, end_daemon

from hil.bench import fan_commands, fan_interlock, fan_start_check
from hil.bench.device_set_from_config import make_device_set
from hil.bench.fan_commands import daemon_spec, daemon_specs
from hil.cli import main
from hil.config.load_cells import LoadCellsConfig
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, UsageError
from hil.core.signals import AdhesionSample, Stamp, Status
from hil.fan_daemon import client
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.server import of_another
from hil.support.emulated_can_mark import is_emulated

pytestmark = pytest.mark.usefixtures("warm_commands")

ROOT = Path(__file__).resolve().parents[2]
WALL = '[environment]\nsurface = "melamine"\ntilt_rad = 1.5707963\n'


EMULATED = f"""
schema = 1
name = "served"
{WALL}
[adhesion]
backend = "emulated"
[emulation.adhesion]
messages_1 = [1]
messages_2 = [4, 5]
[thrust]
model = "vesc"
backend = "emulated"
"""


def bench_file(folder, interface, channel, controller_id, port):
    path = folder / "bench.toml"
    path.write_text(
        f'schema = 1\nname = "robot"\n{WALL}[adhesion]\ninterface = "{interface}"\nchannel = "{channel}"\n'
        f"controller_id = {controller_id}\noptions = {{ port = {port}, hop_limit = 0 }}\n"
    )
    return path


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Bench file of a robot of which only fan and propellers are there, emulated by another process."""
    folder = tmp_path_factory.mktemp("served")
    (folder / "emulated.toml").write_text(EMULATED)
    command = [sys.executable, "-m", "hil.cli", "emulate", "--bench", str(folder / "emulated.toml")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            said = json.loads(process.stdout.readline())
            where, push = said["adhesion"], said["thrust"]
            path = bench_file(
                folder, where["interface"], where["channel"], where["controller_id"], where.get("port", 43113)
            )
            with path.open("a") as file:
                file.write(
                    f'[thrust]\nmodel = "vesc"\ninterface = "{push["interface"]}"\n'
                    f'channel = "{push["channel"]}"\ncontroller_ids = {push["controller_ids"]}\n'
                    f"options = {{ port = {push['port']}, hop_limit = 0 }}\n"
                )
            yield path
            for spec in daemon_specs(load_bench(str(path))).values():
                end_daemon(spec)
            process.terminate()


@pytest.fixture
def at_wire(wire, tmp_path):
    """(fan, spec, bench file) of a fan that does nothing but obey."""
    fan, spec = wire
    path = bench_file(tmp_path, spec.interface, spec.channel, spec.controller_id, spec.options["port"])
    assert daemon_spec(load_bench(str(path))).name == spec.name
    return fan, spec, path


@pytest.fixture
def hil(capsys):
    """Runs a command in this process; (exit code, standard output, messages)."""

    def run(*words):
        capsys.readouterr()
        code = main([str(w) for w in words])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


def test_on_status_watch_and_off_at_an_emulated_vesc(served, hil):
    code, out, err = hil("adhesion", "status", "--bench", served)
    assert (code, "no daemon" in out) == (3, True)
    assert "adhesion has no daemon: nothing commands it now" in err
    code, out, err = hil("adhesion", "on", "--bench", served, "--force", "40", "--json")
    assert code == 0, err
    reported = json.loads(out)
    assert reported["force_n"] == pytest.approx(40.0, rel=0.06)
    assert reported["daemon"]["state"] == "keeping"
    for words in (("status",), ("watch", "--duration", "0.1")):
        code, out, err = hil("adhesion", *words, "--bench", served)
        assert (code, "keeping at duty" in out) == (3, True), "the propellers have no daemon yet"
        assert "thrust has no daemon" in err
        assert "adhesion has no daemon" not in err
    code, _, err = hil("adhesion", "off", "--bench", served)
    assert (code, "--tethered" in err) == (2, True)
    assert (
        json.loads(hil("adhesion", "status", "--bench", served, "--json")[1])["daemon"]["state"] == "keeping"
    )
    code, out, err = hil("adhesion", "off", "--bench", served, "--tethered")
    assert (code, "off (the operator" in out) == (0, True), err
    assert json.loads(hil("adhesion", "status", "--bench", served, "--json")[1])["daemon"]["state"] == "idle"


def test_propellers_on_vescs_are_shown_and_stopped_too(served, hil):
    config = load_bench(str(served))
    spec = daemon_specs(config)["thrust"]
    assert is_emulated(spec.bus), "so that their daemon ends with the emulator"
    propellers = make_device_set(config, MonotonicClock(), {}).get("thrust")
    propellers.open()
    try:
        propellers.set_force_n(10.0)
        for _ in range(300):
            newest = [*propellers.read()][-1:]
            if newest and newest[0].throttle > 0.95 * math.sqrt(10.0 / 39.7):
                break
            time.sleep(0.02)
        assert newest[0].throttle > 0.95 * math.sqrt(10.0 / 39.7)
    finally:
        propellers.close()
    code, out, _ = hil("adhesion", "status", "--bench", served, "--json")
    reported = json.loads(out)["thrust"]
    assert (reported["name"], reported["daemon"]["state"]) == (spec.name, "keeping")
    assert code == (0 if json.loads(out)["daemon"] else 3), "the fan may have been switched on before"
    code, out, err = hil("adhesion", "off", "--bench", served, "--tethered")
    assert (code, f"{spec.name}: off (the operator" in out) == (0, True), err
    reported = json.loads(hil("adhesion", "status", "--bench", served, "--json")[1])["thrust"]
    assert reported["daemon"]["state"] == "idle"


def test_a_force_that_no_fan_has_changes_nothing(served, hil):
    for words in (("--force", "80"), ("--force", "40", "--duty", "0.5"), ("--duty", "1.5")):
        assert hil("adhesion", "on", "--bench", served, *words)[0] == 2


@pytest.mark.parametrize("command", ["on", "watch", "keep"])
def test_a_fan_in_no_process_of_its_own_and_no_fan_are_named(command, hil, tmp_path):
    code, _, err = hil("adhesion", command, "--bench", "emulated")
    assert code == 2
    assert "serve it with `hil emulate`" in err
    path = tmp_path / "bench.toml"
    path.write_text(f'schema = 1\nname = "bare"\n{WALL}[imu]\nport = "/dev/null"\n')
    code, _, err = hil("adhesion", command, "--bench", path)
    assert (code, "bare: no fan; expected a table [adhesion]" in err) == (2, True)


def test_a_fan_that_is_not_there_is_named_and_none_is_started(at_wire, hil):
    fan, _, path = at_wire
    fan.reports = False
    code, _, err = hil("adhesion", "on", "--bench", path)
    assert code == 3, err
    assert "controller 7" in err
    assert fan.duty == 0.0


def test_off_of_another_controller_says_which_one_runs_on(at_wire, hil):
    """A wrong id must not look like a fan that was stopped."""
    _, spec, path = at_wire
    with client.find_or_start(spec) as connection:
        while not client.ask(connection, {"do": "status"}, spec)["report"]:
            time.sleep(0.02)
        client.ask(connection, client.set_request(SetPoint("duty", 0.3)), spec)
        port = spec.options["port"]
        wrong = bench_file(path.parent, spec.interface, spec.channel, spec.controller_id + 1, port)
        code, _, err = hil("adhesion", "off", "--bench", wrong, "--tethered")
        assert code == 3
        assert f"was not stopped; a daemon on its bus commands {spec.name}" in err
        assert client.ask(connection, {"do": "status"}, spec)["state"] == "keeping"


def test_keep_is_a_daemon_in_the_foreground_that_no_signal_ends(at_wire, hil):
    _, spec, path = at_wire
    command = [sys.executable, "-m", "hil.cli", "adhesion", "keep", "--bench", str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert json.loads(process.stdout.readline()) == {"pid": process.pid}
            assert daemon_pid(spec) == process.pid
            process.send_signal(signal.SIGTERM)
            said = (process.stderr.readline() for _ in range(3))
            assert any("SIGTERM is not heeded" in line for line in said)
            code, out, _ = hil("adhesion", "status", "--bench", path)
            assert (code, f"process {process.pid}" in out) == (0, True)
            code, _, err = hil("adhesion", "keep", "--bench", path)
            assert (code, "has a daemon already" in err) == (2, True)
        finally:
            process.kill()


def test_status_reports_the_fan_where_the_propellers_daemon_is_another_users(at_wire, hil, monkeypatch):
    _, spec, path = at_wire
    with path.open("a") as file:
        file.write(
            f'[thrust]\nmodel = "vesc"\ninterface = "{spec.interface}"\nchannel = "{spec.channel}"\n'
            f"controller_ids = [2, 3]\noptions = {{ port = {spec.options['port']}, hop_limit = 0 }}\n"
        )
    ask = fan_commands.daemon_status

    def refused(one):
        if one.device == "thrust":
            raise of_another(one, "root", "user robot (1000)")
        return ask(one)

    monkeypatch.setattr(fan_commands, "daemon_status", refused)
    with client.find_or_start(spec):
        code, out, err = hil("adhesion", "status", "--bench", path, "--json")
        reported = json.loads(out)
        assert (code, reported["daemon"]["state"], reported["thrust"]["daemon"]) == (3, "idle", None)
        assert "the propellers' daemon belongs to root" in err
        code, out, _ = hil("adhesion", "watch", "--bench", path, "--duration", "0.1")
        assert (code, "adhesion: idle" in out, "thrust: its daemon refuses" in out) == (3, True, True)


def test_propellers_that_need_no_daemon_are_given_none(at_wire, hil):
    _, _, path = at_wire
    with path.open("a") as file:
        file.write('[thrust]\nport = "/dev/ttyACM0"\n')
    code, _, err = hil("adhesion", "keep", "--bench", path, "--propellers")
    assert (code, "no propellers that a daemon could run" in err) == (2, True)


def test_the_service_is_started_by_a_command_that_there_is():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(ROOT / "examples" / "hil-adhesion.service")
    words = unit["Service"]["ExecStart"].split()
    assert words[1:4] == ["adhesion", "keep", "--bench"]
    assert unit["Unit"]["RefuseManualStop"] == "yes"
    assert (unit["Service"]["Restart"], unit["Service"]["SendSIGKILL"]) == ("always", "no")
    priority = int(unit["Service"]["CPUSchedulingPriority"])
    assert int(unit["Service"]["LimitRTPRIO"]) >= priority, "the standby asks for it, and is not root"


def fan_says(rpm, duty=math.nan, input_v=math.nan):
    """A report of the fan's controller."""
    return AdhesionSample(Stamp(0, 0, 0), rpm, duty, math.nan, math.nan, input_v, math.nan, math.nan)


class Seen:
    """A device with prescribed samples."""

    def __init__(self, *samples):
        self._samples = samples

    def open(self):
        pass

    def close(self):
        pass

    def read(self):
        return self._samples


def robot(monkeypatch, *, up, cells_n, rpm):
    """What IMU, load cells and fan of a robot say."""
    ok = Status.OK
    devices = {
        "imu": Seen(SimpleNamespace(status=ok, gravity_m_s2=9.81 * np.array(up))),
        "load_cells": Seen(SimpleNamespace(status=(ok, ok), force_n=np.array([cells_n / 2, cells_n / 2]))),
        "adhesion": Seen(fan_says(rpm)),
    }
    for module in (fan_commands, fan_interlock, fan_start_check):
        monkeypatch.setattr(module, "make_device_set", lambda config, clock, connections: devices)
    for module in (fan_commands, fan_interlock):
        monkeypatch.setattr(module, "WATCH_S", 0.05)
    return load_bench("emulated").model_copy(
        update={
            name: load_bench("emulated").devices()[name].model_copy(update={"backend": "real"})
            for name in devices
        }
    )


LEVEL, ON_THE_WALL, TILTED = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, 0.0, 0.954)


def test_a_level_robot_with_nothing_pressed_is_off_the_wall(monkeypatch):
    why = fan_interlock.seen_off_the_wall(robot(monkeypatch, up=LEVEL, cells_n=2.0, rpm=30_000.0))
    assert why == "seen off the wall: tilted by 0 deg, load cells 2.0 N"


@pytest.mark.parametrize(
    ("up", "cells_n", "reported"),
    [
        (LEVEL, 45.0, "tilted by 0 deg, load cells 45.0 N"),
        (TILTED, 0.0, "tilted by 17 deg"),
        ((0.0, 0.0, -1.0), 0.0, "tilted by 180 deg"),
        (LEVEL, math.nan, "load cells nan N"),
        (LEVEL, -30.0, "load cells -30.0 N"),
    ],
)
def test_one_sensor_that_says_it_may_hang_is_enough_to_refuse(monkeypatch, up, cells_n, reported):
    with pytest.raises(UsageError, match=rf"may hang by its fan: .*{reported}.*9.0 N.*--tethered"):
        fan_interlock.seen_off_the_wall(robot(monkeypatch, up=up, cells_n=cells_n, rpm=30_000.0))


@pytest.mark.parametrize(("cells_n", "zero_n", "off_the_wall"), [(5.0, -40.0, False), (42.0, 40.0, True)])
def test_the_cells_say_it_by_their_force_without_their_zeros(monkeypatch, cells_n, zero_n, off_the_wall):
    config = robot(monkeypatch, up=LEVEL, cells_n=cells_n, rpm=30_000.0)
    cells = config.of(LoadCellsConfig).model_copy(update={"zero_n": (zero_n, 0.0)})
    config = config.model_copy(update={"load_cells": cells})
    if off_the_wall:
        assert "load cells 2.0 N" in fan_interlock.seen_off_the_wall(config)
    else:
        with pytest.raises(UsageError, match=r"may hang by its fan: .*load cells 45\.0 N"):
            fan_interlock.seen_off_the_wall(config)


def test_without_witnesses_only_the_operator_can_say_it(monkeypatch):
    config = robot(monkeypatch, up=LEVEL, cells_n=0.0, rpm=30_000.0)
    emulated = config.imu.model_copy(update={"backend": "emulated"})
    with pytest.raises(UsageError, match=r"no imu of the robot.*--tethered"):
        fan_interlock.seen_off_the_wall(config.model_copy(update={"imu": emulated}))


def asked_of(monkeypatch, *, up, cells_n, rpm, **asked):
    """What `switch_on` asked of the fan since it opened it last."""
    config, given = robot(monkeypatch, up=up, cells_n=cells_n, rpm=rpm), []
    fan = fan_commands.make_device_set(None, None, None)["adhesion"]
    sample = fan_says(rpm, rpm / 36_000.0, 22.0)
    fan.__dict__.update(
        open=given.clear,
        read=lambda: given.append("read") or (sample,),
        set_force_n=lambda n: given.append(n),
        set_duty=lambda d: given.append(d),
    )
    monkeypatch.setattr(fan_commands, "daemon_status", lambda spec: None)
    with contextlib.suppress(DeviceError):  # it never gets there
        fan_commands.switch_on(
            config,
            force_n=asked.get("force_n"),
            duty=asked.get("duty"),
            wait_s=0.0,
            say=print,
            tethered=asked.get("tethered", False),
        )
    return given


@pytest.mark.parametrize(
    ("asked", "rpm", "reported"),
    [
        ({"duty": 0.05}, 30_000.0, "stays at 45.0 N, it is not set to 0.2 N"),
        ({"force_n": 40.0}, 30_000.0, "it is not set to 40.0 N"),
        ({"force_n": 20.0}, 0.0, "stays at 0.0 N, it is not set to 20.0 N; 29.2 N are the least"),
        ({}, 33_000.0, "stays at 54.5 N, it is not set to 45.0 N"),
    ],
)
def test_a_set_point_that_lets_the_robot_fall_is_refused_as_off_is(monkeypatch, asked, rpm, reported):
    with pytest.raises(UsageError, match=rf"{reported}.*may hang by its fan: tilted by 90 deg.*--tethered"):
        asked_of(monkeypatch, up=ON_THE_WALL, cells_n=45.0, rpm=rpm, **asked)


@pytest.mark.parametrize(
    ("asked", "up", "cells_n", "rpm", "given"),
    [
        ({"force_n": 3.0}, LEVEL, 0.0, 30_000.0, 3.0),
        ({"duty": 0.05, "tethered": True}, ON_THE_WALL, 45.0, 30_000.0, 0.05),
        ({}, ON_THE_WALL, 45.0, 30_400.0, 45.0),
        ({"duty": 0.9}, ON_THE_WALL, 45.0, 30_000.0, 0.9),
        ({"force_n": 40.0}, ON_THE_WALL, 0.0, 0.0, 40.0),
    ],
)
def test_a_set_point_that_holds_the_robot_or_is_vouched_for_is_given(
    monkeypatch, asked, up, cells_n, rpm, given
):
    asked_for = asked_of(monkeypatch, up=up, cells_n=cells_n, rpm=rpm, **asked)
    assert asked_for == ["read", given], "it was heard first, so that the set-point begins from how it runs"


def test_a_fan_that_a_bench_commands_is_left_to_it(at_wire, hil):
    """Its session asks for its own force again; so is one that `hil adhesion on` waits for."""
    _, spec, path = at_wire
    with client.find_or_start(spec) as connection:
        while not client.ask(connection, {"do": "status"}, spec)["report"]:
            time.sleep(0.02)
        assert client.ask(connection, {"do": "status"}, spec)["set_by"] == []
        client.ask(connection, client.set_request(SetPoint("duty", 0.3)), spec)
        (pid,) = client.ask(connection, {"do": "status"}, spec)["set_by"]
        assert pid == os.getpid()
    with subprocess.Popen(
        [sys.executable, "-c", SETS, spec.to_json()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as bench:
        assert bench.stdout.readline() == "set\n"
        for more in ((), ("--tethered",)):
            code, _, err = hil("adhesion", "on", "--bench", path, "--force", "5", *more)
            assert (code, f"(process {bench.pid}) commands the fan now" in err) == (2, True), err
        bench.stdin.close()
        bench.wait()
    with client.connect(spec) as connection:
        status = client.ask(connection, {"do": "status"}, spec)
        assert (status["set_by"], status["target"]) == ([], ["duty", 0.4])


SETS = """
import sys
from hil.fan_daemon import client
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.spec import Spec

spec = Spec.from_json(sys.argv[1])
connection = client.connect(spec)
client.ask(connection, client.set_request(SetPoint("duty", 0.4)), spec)
print("set", flush=True)
sys.stdin.read()
"""


def test_on_asks_the_load_cells_before_it_says_that_the_fan_presses(monkeypatch):
    """Another motor may answer at the fan's id: it turns as told, and nothing presses."""
    config = robot(monkeypatch, up=ON_THE_WALL, cells_n=0.2, rpm=30_000.0)
    check = fan_start_check.FanStartCheck(config, config.devices()["adhesion"])
    assert "load cells measure 0.2 N, and the speed is good for 45.0 N" in check.by_cells(
        45.0, MonotonicClock()
    )
    config = robot(monkeypatch, up=ON_THE_WALL, cells_n=44.0, rpm=30_000.0)
    check = fan_start_check.FanStartCheck(config, config.devices()["adhesion"])
    assert check.by_cells(45.0, MonotonicClock()) == ""


def test_a_fan_of_which_one_measurement_says_less_is_not_taken_for_less(monkeypatch):
    """The speed says 11 N, duty and voltage 45 N: 40 N would lower it."""
    config = robot(monkeypatch, up=ON_THE_WALL, cells_n=45.0, rpm=15_000.0)
    fan = config.devices()["adhesion"]
    assert max(fan_interlock.forces_now_n(fan, fan_says(15_000.0, 0.83, 22.0))) > 40.0
    assert fan_interlock.duty_n(fan, 0.83, fan_says(60_000.0, 0.83, 22.0)) < 50.0


def test_a_fan_that_is_taken_back_goes_to_its_set_point_of_before_not_to_a_place_on_its_ramp(
    served, hil, tmp_path
):
    wrong, before = tmp_path / "wrong.toml", SetPoint("duty", 0.7)
    wrong.write_text(served.read_text().replace("[adhesion]\n", "[adhesion]\npole_pairs = 7\n"))
    code, _, err = hil("adhesion", "on", "--bench", served, "--force", "20", "--tethered")
    assert code == 0, err
    spec = daemon_spec(load_bench(str(served)))
    with client.connect(spec) as connection:
        on_ramp = client.ask(connection, client.set_request(before), spec)["sent"]
        code, _, err = hil("adhesion", "on", "--bench", wrong, "--force", "45", "--tethered")
        aim = client.ask(connection, {"do": "status"}, spec)["target"]
    assert (code, "pole_pairs" in err) == (3, True)
    assert on_ramp[1] < 0.6
    assert aim == ["duty", pytest.approx(before.value, rel=0.05)]
