"""The daemon as a process: small, ignoring signals, for its own user, found by other programs."""

import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing, contextmanager

import pytest
from kills import commanded, end_daemon

from hil.core.errors import DeviceError, UsageError
from hil.fan_daemon import client, server, standby
from hil.fan_daemon.fan_control import SetPoint
from hil.fan_daemon.server import Server
from hil.fan_daemon.spec import Spec

POINT = SetPoint("duty", 0.3)


def eventually(true, within_s=10.0):
    end_s = time.monotonic() + within_s
    while not (found := true()) and time.monotonic() < end_s:
        time.sleep(0.02)
    return found


@pytest.fixture
def daemon(shared):
    """(fan, spec, connection to its daemon, which is started where there is none)."""
    fan, spec = shared
    with client.find_or_start(spec) as connection:
        yield fan, spec, connection


def test_fans_on_buses_with_long_names_have_a_daemon_each():
    adapter = "/dev/serial/by-id/usb-Protofusion_Labs_CANable_1205aa6_cantact-fw_001C003A5434510C20313732-if0"
    specs = [Spec("slcan", f"{adapter}{end}", number) for end in (0, 1) for number in (7, 8)]
    with ExitStack() as stack:
        for spec in specs:
            stack.callback(Server(spec).close)
        running = set(server.running_daemons())
        names = [server.socket_name(spec) for spec in specs]
        assert len(set(names)) == len(specs)
        assert running.issuperset(names)
        for spec in specs:
            assert [server.is_on(name, spec.bus) for name in names] == [s.bus == spec.bus for s in specs]
            client.connect(spec).close()
            with pytest.raises(server.TakenError):
                Server(spec)


def is_unkept(spec):
    connection = client.connect(spec)
    if connection is not None:
        connection.close()
    return connection is None


@contextmanager
def emulating(spec):
    """A process that says that it emulates the fan's bus."""
    mark = f"Mark({spec.bus!r}, {spec.bitrate})"
    code = f"from hil.support.emulated_can_mark import Mark; marked = {mark}; print(); input()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as emulator:
        emulator.stdout.readline()
        yield emulator


@contextmanager
def answering(spec, answers):
    """A server that gives one answer after another, to any client."""
    listener, left = Server(spec), list(answers)
    ended = threading.Event()

    def serve():
        while not ended.is_set():
            listener.serve(0.01, lambda asked, who: left.pop(0))

    thread = threading.Thread(target=serve)
    thread.start()
    yield
    ended.set()
    thread.join()
    listener.close()


def log_and_standby(connection, spec, but=None):
    """Path of the log and the standby's process id; None before there is one (but this)."""
    status = client.ask(connection, {"do": "status"}, spec)
    return (status["log"], status["standby"]) if status["standby"] not in (None, but) else None


def written(log):
    with open(log, encoding="utf-8") as file:
        return file.read()


def set_when_heard(connection, spec, point=POINT):
    """Ask for a set-point as soon as the daemon has heard its fan."""
    eventually(lambda: client.ask(connection, {"do": "status"}, spec)["report"])
    return client.ask(connection, client.set_request(point), spec)


def test_it_imports_little():
    code = "import sys, hil.fan_daemon.process; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = {name.partition(".")[0] for name in modules.split()}
    assert loaded.isdisjoint({"numpy", "numba", "pydantic", "cantools", "click", "scipy"})


def test_it_keeps_the_fan_through_every_signal_that_can_be_caught(daemon):
    fan, spec, connection = daemon
    set_when_heard(connection, spec)
    assert eventually(lambda: fan.duty == POINT.value)
    since_s = time.time()
    pid = client.peer(connection)[0]
    for name in ("SIGHUP", "SIGINT", "SIGTERM", "SIGQUIT", "SIGPIPE", "SIGUSR1", "SIGALRM", "SIGTSTP"):
        os.kill(pid, getattr(signal, name))
    commanded(fan, time.time())
    status = client.ask(connection, {"do": "status"}, spec)
    assert (status["pid"], status["state"]) == (pid, "keeping")
    assert max(fan.gaps_s(since_s)) <= 0.2
    assert "SIGTERM is not heeded" in written(status["log"])
    assert stat.S_IMODE(os.stat(status["log"]).st_mode) == 0o600, "for its owner"


def test_it_belongs_to_no_session_and_no_parent_of_ours(daemon):
    pid = client.peer(daemon[2])[0]
    with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
        fields = file.read().rpartition(") ")[2].split()
    parent, group, session, terminal = map(int, fields[1:5])
    assert parent != os.getpid()
    assert group != os.getpgrp()
    assert session != os.getsid(0)
    assert terminal == 0


def test_off_without_a_confirmation_is_refused_and_the_fan_runs_on(daemon):
    fan, spec, connection = daemon
    set_when_heard(connection, spec)
    rest = client.set_request(SetPoint("duty", 0.0))
    for request in ({"do": "off"}, {"do": "off", "confirmed_by": " "}, rest):
        with pytest.raises(UsageError, match="hil adhesion off"):
            client.ask(connection, request, spec)
    assert client.ask(connection, {"do": "status"}, spec)["state"] == "keeping"
    client.ask(connection, client.off_request("a test's fan"), spec)
    assert eventually(lambda: client.ask(connection, {"do": "status"}, spec)["state"] == "idle")
    assert eventually(lambda: fan.duty == 0.0)


def test_nonsense_is_refused_and_changes_nothing(daemon):
    _, spec, connection = daemon
    set_when_heard(connection, spec)
    for packet in (
        b"\xff\x00",
        b"[" * 5000,
        b"[1]",
        b'{"do": ["set"]}',
        b'{"do": "set", "quantity": "duty", "value": "much"}',
        b'{"do": "set", "quantity": "duty", "value": NaN}',
        b'{"do": "set", "quantity": "speed", "value": 0.3}',
        b'{"do": "set", "quantity": "duty", "value": 1' + b"0" * 400 + b"}",
        b'{"do": "set"}',
        b'{"do": "set", "quantity": "' + b"\xc3\xa4" * 4000 + b'", "value": 0.3}',
        b'{"do": "off"}',
    ):
        connection.send(packet)
        refused = json.loads(connection.recv(server.MOST_BYTES))["error"]
        assert refused["exit_code"] == 2
        assert refused["expected"]
        assert refused["remedy"]
    assert client.ask(connection, {"do": "status"}, spec)["target"] == ["duty", POINT.value]


def test_clients_that_crowd_and_never_read_delay_no_command(daemon):
    fan, spec, connection = daemon
    set_when_heard(connection, spec)
    since_s = time.time()
    crowd = [client.connect(spec) for _ in range(60)]
    for one in crowd:
        one.setblocking(False)
        for _ in range(20):
            try:
                one.send(b'{"do": "status"}')
            except OSError:
                break
    commanded(fan, time.time())
    assert max(fan.gaps_s(since_s)) <= 0.2
    for one in crowd:
        one.close()
    assert client.ask(connection, {"do": "status"}, spec)["state"] == "keeping"


def test_a_fan_has_one_daemon(daemon):
    _, spec, connection = daemon
    pid = client.peer(connection)[0]
    with pytest.raises(DeviceError, match="has a daemon already"):
        Server(spec)
    said = client.DaemonLaunch(spec, emulated=False).first_line(15.0)
    assert "has a daemon already" in said["error"]
    assert client.peer(connection)[0] == pid
    Server(Spec(spec.interface, spec.channel, 8, options=spec.options)).close()  # another fan has its own


@pytest.mark.parametrize(
    ("asks", "owns", "may"), [(0, 1000, True), (1000, 1000, True), (1000, 0, False), (1000, 1001, False)]
)
def test_a_daemon_talks_to_its_own_user_and_to_root(asks, owns, may):
    assert server.may_ask(asks, owns) is may


def test_another_users_daemon_is_not_asked_and_named_with_the_remedy_and_its_end(wire, monkeypatch):
    _, spec = wire
    monkeypatch.setattr(client, "may_ask", lambda uid, owner: False)
    monkeypatch.setattr(client, "peer", lambda connection: server.Peer(7, 54321))
    reported = "daemon belongs to user 54321, and this program to "
    with closing(Server(spec)), pytest.raises(DeviceError, match=reported) as caught:
        client.connect(spec)
    assert "run this as user 54321, or as root; a daemon that is no service ends 30 s" in caught.value.remedy


@pytest.mark.parametrize("asked_before_it_is_let_in", [True, False])
def test_a_refused_client_gets_the_reason_and_no_answer(wire, monkeypatch, asked_before_it_is_let_in):
    _, spec = wire
    listener = Server(spec)
    monkeypatch.setattr(server, "may_ask", lambda uid, owner: False)

    def turn_away():
        listener.serve(1.0, lambda asked, who: pytest.fail("it was answered"))

    with client.connect(spec) as refused:
        if asked_before_it_is_let_in:
            refused.send(b'{"do": "status"}')
        turn_away()
        if asked_before_it_is_let_in:
            reported = json.loads(refused.recv(server.MOST_BYTES))["error"]
            assert (reported["exit_code"], "daemon belongs to " in reported["message"]) == (3, True)
            assert refused.recv(10) == b""
        else:
            with pytest.raises(DeviceError, match=r"the fan's daemon belongs to .*, and this program"):
                client.ask(refused, {"do": "status"}, spec)
    listener.close()


def test_a_daemon_that_many_talk_to_says_so(wire):
    _, spec = wire
    listener = Server(spec)
    crowd = []
    for _ in range(33):
        crowd.append(client.connect(spec))
        listener.serve(1.0, lambda asked, who: {})
    with pytest.raises(DeviceError, match=r"talks to 32 programs already.*end programs that talk to it"):
        client.ask(crowd[-1], {"do": "status"}, spec)
    for one in crowd:
        one.close()
    listener.close()


def test_a_standby_that_there_is_no_room_for_knows_nothing(wire):
    _, spec = wire
    reported = [{"state": "keeping", "pid": 1}, {"error": {"message": "no room"}}]
    with answering(spec, reported):
        assert standby.wait_as_standby(spec) == {"state": "keeping", "pid": 1}


as_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
BECOME_NOBODY = "os.setgroups([]); os.setgid(65534); os.setuid(65534)"
"""Once everything is imported: what it is imported from need not be readable for everybody."""


@as_root
def test_root_asks_the_daemon_of_another_user_and_learns_whose_it_is(wire):
    _, spec = wire
    code = (
        "import os, sys, can.interfaces.udp_multicast; "
        "from hil.fan_daemon.process import main; "
        f"{BECOME_NOBODY}; main([sys.argv[1], '--stay'])"
    )
    command, quiet = [sys.executable, "-c", code, spec.to_json()], subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, cwd="/") as process:
        try:
            assert json.loads(process.stdout.readline()) == {"pid": process.pid}
            with client.connect(spec) as connection:
                status = set_when_heard(connection, spec)
                assert (status["state"], status["uid"]) == ("keeping", 65534)
                assert re.fullmatch(r" of user (\w+ \()?65534\)?", client.of_whom(status))
                off = client.ask(connection, client.off_request("a test"), spec)
                assert off["state"] == "ending"
        finally:
            process.kill()


@as_root
def test_another_user_learns_that_the_daemon_is_roots(daemon):
    _, spec, _ = daemon
    code = (
        "import os, sys; from hil.fan_daemon import client, spec; "
        f"{BECOME_NOBODY}; client.connect(spec.Spec.from_json(sys.argv[1]))"
    )
    command = [sys.executable, "-c", code, spec.to_json()]
    done = subprocess.run(command, capture_output=True, text=True, cwd="/", check=False)
    assert "the fan's daemon belongs to root, and this program to user " in done.stderr
    assert "run this as root" in done.stderr


def test_a_bus_that_is_not_there_is_asked_to_who_starts_it(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with pytest.raises(DeviceError, match=r"did not start: .*CAN bus cannot be opened .*interface up"):
        client.find_or_start(Spec("socketcan", "can77", 7))


def test_an_emulator_that_ends_takes_daemon_and_standby_along_in_two_plain_lines(wire):
    """The standby goes on for no bus that is gone, and starts none of its own that would wait for it."""
    _, spec = wire
    with emulating(spec) as emulator, client.find_or_start(spec) as connection:
        set_when_heard(connection, spec)
        log, second = eventually(lambda: log_and_standby(connection, spec))
        emulator.kill()
        emulator.wait()
        connection.settimeout(10.0)
        assert connection.recv(1) == b""
    gone = f"{spec.bus} was emulated and is gone; so is the"
    assert eventually(lambda: all(f"{gone} {who}" in written(log) for who in ("daemon", "standby")))
    last = [line.partition(" ")[2].partition(" ")[2] for line in written(log).splitlines()[-2:]]
    assert sorted(last) == [f"{gone} daemon", f"{gone} standby, process {second}"]
    assert is_unkept(spec)


def test_a_standby_that_is_killed_is_replaced_and_both_are_reported(daemon):
    _, spec, connection = daemon
    set_when_heard(connection, spec)
    log, first = eventually(lambda: log_and_standby(connection, spec))
    os.kill(first, signal.SIGKILL)
    _, second = eventually(lambda: log_and_standby(connection, spec, but=first))
    gone = f"the standby of the fan's daemon, process {first}, is gone; another is started"
    assert eventually(lambda: gone in written(log))
    assert eventually(lambda: f"the fan's daemon has a standby, process {second}" in written(log))


def test_standbys_that_end_as_soon_as_they_have_come_are_not_started_without_pause(monkeypatch):
    started = []
    monkeypatch.setattr(standby.subprocess, "Popen", lambda command, **how: started.append(command))
    monkeypatch.setattr(standby, "_LASTING_NS", 10**15)
    seen = standby.StandbyStarter(Spec("socketcan", "can0", 7), ["start"], lambda text: None)
    for pid in range(1, 10):
        seen.start_if_missing(time.monotonic_ns())
        seen.heard(pid)
        seen.left(pid)
    assert len(started) == 1


def test_nothing_is_left_where_it_listened(daemon):
    _, spec, _ = daemon
    end_daemon(spec)
    assert is_unkept(spec)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as free:
        free.bind(server.address(spec))


def test_what_python_can_would_load_beside_is_kept_out_of_locked_memory(tmp_path):
    """python-can imports asammdf where that is installed, and with it pandas: 100 MB that would be locked."""
    seen = tmp_path / "loaded"
    (tmp_path / "asammdf.py").write_text(f"open({str(seen)!r}, 'w').close(); raise ImportError\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), *filter(None, sys.path)))}

    def run(*words):
        return subprocess.run(
            [sys.executable, *words], env=environment, capture_output=True, text=True, timeout=120
        )

    done = run("-m", "hil.fan_daemon", "--stay", "no specification")
    assert "error" in json.loads(done.stdout)
    assert not seen.exists()
    run("-c", "import can")
    assert seen.exists(), "python-can no longer imports it"
