"""A sensor that is unplugged for a while: the run goes on, and nothing is left behind."""

import itertools
import json
import threading
import time

import pytest

import hil
from hil.bench.loop_settings import fail_limits
from hil.bench.reconnect import Reconnecting, reconnecting
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.interfaces import Sensor
from hil.core.signals import Status, worst
from hil.live import LivePlan, LiveSession
from hil.recording.mcap_reader import read_cycles

CLOCK = MonotonicClock()


class Plug(Sensor):
    """A sensor of plain numbers whose plug a test pulls."""

    def __init__(self):
        self.name, self.plugged, self.handles, self.opened = "plug", True, 0, 0
        self.port_gone, self.raises, self.number, self.tried = False, DeviceTimeoutError, 0, 0

    def open(self):
        self.tried += 1
        self.close()
        if not self.plugged:
            raise self.raises("plug", "no device there", remedy="plug it in")
        self.handles += 1
        self.opened += 1
        self.port_gone = False

    def reopen(self):
        self.open()

    def close(self):
        self.handles = 0

    def identity(self):
        return {"model": "plug"} if self.handles else {}

    def read(self):
        if not self.plugged:
            raise DeviceTimeoutError("plug", "silent")
        self.number += 1
        return (self.number,)


def wait_for(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.002)
    return found


@pytest.fixture
def plug(monkeypatch):
    monkeypatch.setattr("hil.bench.reconnect._PAUSE_S", 0.002)
    return Plug()


def test_a_hundred_times_unplugged_nothing_is_lost_and_nothing_left(plug):
    before = threading.active_count()
    sensor = Reconnecting(plug, CLOCK)
    sensor.open()
    for _ in range(100):
        assert len(wait_for(sensor.read)) == 1
        plug.plugged = False
        assert sensor.read() == ()
        assert sensor.identity() == {}
        assert threading.active_count() == before + 1
        plug.plugged = True
    assert wait_for(sensor.read)[0] == plug.number
    assert (plug.opened, plug.handles, threading.active_count()) == (101, 1, before)
    sensor.close()
    assert plug.handles == 0


def test_one_that_does_not_come_back_ends_the_run_with_what_to_do(plug):
    before = threading.active_count()
    sensor = Reconnecting(plug, CLOCK, patience_s=0.1)
    sensor.open()
    plug.plugged = False
    with pytest.raises(DeviceTimeoutError, match=r"silent; it did not come back within .*plug it in"):
        wait_for(sensor.read)
    assert sensor.read() == ()  # who goes on reading waits anew
    sensor.close()  # ends the waiting
    assert threading.active_count() == before


@pytest.mark.parametrize("error", [DeviceError, lambda *_, **__: KeyError("of a library")])
def test_whatever_opening_raises_it_is_tried_again(plug, error):
    sensor = Reconnecting(plug, CLOCK)
    sensor.open()
    plug.plugged, plug.raises = False, error
    assert sensor.read() == ()
    wait_for(lambda: plug.tried > 3)
    plug.plugged = True
    assert wait_for(sensor.read)
    sensor.close()


def test_a_port_that_has_gone_is_not_waited_for_in_vain(plug):
    sensor = Reconnecting(plug, CLOCK)
    sensor.open()
    plug.port_gone = True
    assert len(sensor.read()) == 1
    assert wait_for(sensor.read)
    assert plug.opened == 2
    sensor.close()


class Hands(MonotonicClock):
    """A clock of a test: it stands until it is put on."""

    def __init__(self):
        self.t_ns = 0

    def now_ns(self):
        return self.t_ns


def test_without_waiting_a_driver_that_gives_up_ends_the_run_in_its_own_words(plug):
    before = threading.active_count()
    sensor = reconnecting({"plug": plug}, CLOCK, {"plug": 2.0})["plug"]
    sensor.open()
    plug.plugged = False
    with pytest.raises(DeviceTimeoutError, match="plug: silent"):
        sensor.read()
    assert threading.active_count() == before
    sensor.close()


def test_without_waiting_a_port_that_has_gone_is_opened_again_until_its_limit(plug):
    clock = Hands()
    sensor = reconnecting({"plug": plug}, clock, {"plug": 2.0})["plug"]
    sensor.open()
    plug.port_gone, plug.raises = True, DeviceError
    assert len(sensor.read()) == 1
    assert wait_for(sensor.read)  # it was back at once
    held_back, plug.reopen = threading.Event(), lambda: held_back.wait(5.0)
    plug.port_gone = True
    sensor.read()
    clock.t_ns = 2_000_000_000
    assert sensor.read() == ()
    clock.t_ns = 2_100_000_000
    with pytest.raises(DeviceTimeoutError, match=r"port has gone; it did not come back within 2\.1 s"):
        sensor.read()
    held_back.set()
    sensor.close()


@pytest.mark.parametrize("plan", [LivePlan(), LivePlan(trajectory=lambda _: None)])
def test_who_only_watches_waits_and_who_drives_does_not(plan):
    bench = hil.open_bench("emulated_floor")
    assert not bench.waits_for_sensors
    LiveSession(bench, plan)
    assert bench.waits_for_sensors is (plan.trajectory is None)
    bench.close()


def test_the_limits_of_a_bench_are_those_of_its_drivers():
    limits = fail_limits(load_bench("emulated", overrides={"encoders.fail_after_s": 1.5}))
    assert limits == {"encoders": 1.5, "imu": 3.0, "tracker": 2.0, "mocap": 2.0, "load_cells": 1.0}


@pytest.mark.long
def test_four_sensors_are_unplugged_while_hil_live_watches(tmp_path, capsys):
    """Longer than their drivers wait; each gap is in the recording, and named."""
    faults = {"imu": (4.5, 3.6), "encoders": (5.0, 1.6), "tracker": (5.5, 2.6), "mocap": (4.0, 2.6)}
    spec = [word for name, (at, s) in faults.items() for word in ("--fault", f"{name}:unplug@{at}+{s}")]
    recording, bench = tmp_path / "run.mcap", tmp_path / "bench.toml"
    bench.write_text(
        'schema = 1\nname = "four"\n[environment]\nsurface = "floor"\ntilt_rad = 0.0\n'
        + "".join(f'[{name}]\nbackend = "emulated"\n' for name in faults)
    )
    words = ["live", "--bench", str(bench), "--duration", "11", "--feedback", "odometry"]
    code = main([*words, "--record", str(recording), "--json", *spec])
    reported = json.loads(capsys.readouterr().out)
    assert code == 0, reported
    assert not [t for t in threading.enumerate() if t.name.endswith(" again")]
    records = list(read_cycles(recording))
    for name, (_, away_s) in faults.items():
        good = [r.inputs.t_ns for r in records for s in r.inputs.of(name) if worst(s) is Status.OK]
        gap_s = max(b - a for a, b in itertools.pairwise(good)) / 1e9
        assert gap_s >= away_s - 0.1
        said_s = [
            float(e.message.split()[-2])
            for r in records
            for e in r.events
            if e.source == name and e.message.startswith("answers again")
        ]
        assert max(said_s) == pytest.approx(gap_s, abs=0.02)
        assert good[-1] > records[-1].inputs.t_ns - 500_000_000
