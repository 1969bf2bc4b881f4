"""Two devices of one kind on a bench: each has its own table, world, faults, samples, topic and name."""

import json
import sys

import numpy as np
import pytest
import tomli_w
import tomllib
from faulty_package import PACKAGE
from mcap.reader import make_reader

import hil
from hil.bench.doctor.discovery import discover
from hil.bench.doctor.examination import examine
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.errors import ConfigError, DeviceError, FaultNotSupportedError, SafetyStop
from hil.core.signals import Status
from hil.datasets.export import wheel_table
from hil.fakes.world import VirtualClock
from hil.loop.cycle_data import LastingCheck
from hil.monitor.plot_series import SeriesCollector, conditions
from hil.recording.mcap_reader import read_cycles
from hil.recording.rosbags_adapter import from_cdr

HEAD = """
schema = 1
name = "two"
{}
[environment]
surface = "floor"
tilt_rad = 0.0
"""
IMUS = """
[[imu]]
name = "body"
backend = "emulated"

[[imu]]
name = "arm"
backend = "emulated"
mount_position_m = [0.1, 0.0, 0.0]
"""
RANGES = """
[[rangefinder]]
name = "front"
backend = "emulated"

[[rangefinder]]
name = "rear"
backend = "emulated"
mount_position_m = [-0.12, 0.0, 0.05]
mount_rotation_wxyz = [0.0, 0.0, 0.0, 1.0]

[emulation.rangefinder_front]
plate_x_m = 2.0

[emulation.rangefinder_rear]
plate_x_m = -1.0
"""
LOOK = """
from hil.procedure import procedure


@procedure(name="look", needs=("imu", "imu_arm"))
def run(ctx):
    ctx.bench.observe(0.6, feedback="odometry")
"""
REAL = 'port = "/dev/nope{}"'


@pytest.fixture
def file(tmp_path):
    """Writes a bench file of these devices."""

    def written(*tables):
        path = tmp_path / "bench.toml"
        path.write_text(HEAD.format("") + "".join(tables))
        return str(path)

    return written


@pytest.fixture
def ranges(rangefinder, monkeypatch, forget):
    """The package of the range finder."""
    monkeypatch.setattr(sys, "path", [str(rangefinder), *sys.path])
    forget()
    import hil_rangefinder

    return hil_rangefinder


def observed(bench, duration_s=0.6, **given):
    with hil.open_bench(bench, seed=4, **given) as opened:
        return opened.observe(duration_s, feedback="odometry").records


def samples(records, name):
    return [s for record in records for s in record.inputs.of(name) if s.status is Status.OK]


def reported(records):
    return {event.source for record in records for event in record.events}


@pytest.mark.usefixtures("ranges")
def test_both_of_a_package_are_measured_each_where_it_is(file):
    records = observed(file(RANGES))
    front, rear = (
        np.array([s.distance_m for s in samples(records, f"rangefinder_{name}")])
        for name in ("front", "rear")
    )
    assert front.mean() == pytest.approx(2.0 - 0.12, abs=0.04)
    assert rear.mean() == pytest.approx(1.0 - 0.12, abs=0.04)
    n = min(len(front), len(rear))
    assert n > 40
    assert abs(np.corrcoef(front[:n], rear[:n])[0, 1]) < 0.7  # their noise is not the same numbers
    assert records[-1].measurements.added["rangefinder_rear"] == records[-1].inputs.of("rangefinder_rear")
    assert conditions(records[-1]) == {"rangefinder_front": "", "rangefinder_rear": ""}
    drawn = SeriesCollector()
    drawn.add(records[-1])
    values = {entity: series.values[-1, 0] for entity, series in drawn.take()}
    assert values["rangefinder/distance_m_front"] == front[-1]
    assert values["rangefinder/distance_m_rear"] == rear[-1]


@pytest.mark.usefixtures("ranges")
def test_the_one_that_falls_silent_ends_the_run_by_its_name(file):
    with pytest.raises(DeviceError, match=r"^rangefinder_rear at hil://\S+: no distance") as found:
        observed(file(RANGES), 6.0, faults="rangefinder_rear:off@0.3")
    assert found.value.device == "rangefinder_rear"
    records = observed(file(RANGES), 2.0, faults="rangefinder_rear:off@0.3+1")
    assert reported(records) == {"rangefinder_rear"}


def test_a_check_of_the_kind_stops_for_the_one_that_it_is_about(file, ranges, monkeypatch):
    near = lambda s: f"{s.distance_m:.1f} m" if s.distance_m < 1.0 else ""  # noqa: E731
    checks = lambda self, config: (LastingCheck("rangefinder", "too_near", near),)  # noqa: E731
    monkeypatch.setattr(ranges.RangeFinder, "checks", checks)
    with pytest.raises(SafetyStop, match=r"rear range finder: 0\.9 m") as stop:
        observed(file(RANGES))
    assert (stop.value.reason, stop.value.suspects) == ("too_near", ("rangefinder_rear",))


@pytest.mark.usefixtures("ranges")
def test_a_second_one_draws_no_random_number_of_the_first(file):
    def serials(tables):
        with hil.open_bench(file(tables), seed=4) as bench:
            return [device.identity()["serial"] for device in bench.devices.devices()]

    alone = serials('[rangefinder]\nbackend = "emulated"\n')
    first, second = serials(RANGES.partition("[emulation")[0].replace("front", "rangefinder"))
    assert [first] == alone
    assert second != first


def test_two_imus_are_recorded_replayed_and_struck_each_by_itself(file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "look.py").write_text(LOOK)
    run = ["run", "look.py", "--bench", file(IMUS), "--fault", "imu_arm:stuck@0.3", "--out", "o"]
    assert main(run) == 0
    with (tmp_path / "o" / "recording.mcap").open("rb") as recording:
        messages = list(make_reader(recording).iter_messages(topics=["/imu/data_arm"]))
    records = list(read_cycles(tmp_path / "o" / "recording.mcap"))
    assert len(messages) == sum(len(record.inputs.of("imu_arm")) for record in records) > 40
    frames = {from_cdr(m.data, schema.name).header.frame_id for schema, _, m in messages}
    assert frames == {"imu_arm"}
    assert reported(records) == {"imu_arm"}
    assert {s.status for r in records for s in r.inputs.of("imu_arm")} == {Status.OK, Status.FROZEN}
    assert {s.status for r in records for s in r.inputs.imu} == {Status.OK}
    capsys.readouterr()
    assert main(["replay", "o/recording.mcap", "--verify", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "identical"
    assert {"imu_arm_gyro_rad_s_2", "imu_arm_t"} <= {*wheel_table(records).columns}


def test_an_axis_of_further_encoders_is_struck_by_itself(file):
    tables = '[[encoders]]\nname = "encoders"\nbackend = "emulated"\n'
    tables += '[[encoders]]\nname = "rear"\nnode_id = 8\nbackend = "emulated"\n'
    records = observed(file(tables), faults="encoders_rear.FL:off@0.2")
    statuses = {
        name: {axis for r in records[40:] for s in r.inputs.of(name) for axis in s.status}
        for name in ("encoders", "encoders_rear")
    }
    assert statuses == {"encoders": {Status.OK}, "encoders_rear": {Status.OK, Status.STARTING}}


def test_the_benchs_own_is_meant_by_its_name_too(file):
    assert reported(observed(file(IMUS), faults="imu_body:stuck@0.3")) == {"imu"}


@pytest.mark.usefixtures("ranges")
def test_the_doctor_has_a_word_for_each(file):
    found = list(examine(hil.open_bench(file(RANGES, IMUS), faults="imu_arm:off"), watch_s=0.3))
    assert {f.device for f in found} - {"bench"} == {
        "imu",
        "imu_arm",
        "rangefinder_front",
        "rangefinder_rear",
    }
    assert {f.device for f in found if f.level == "failure"} == {"imu_arm"}


@pytest.mark.real_time
def test_at_the_wire_each_has_a_place_of_its_own(file):
    with hil.open_bench(file(IMUS), realtime=True, overrides={"imu.fail_after_s": 30.0}) as bench:
        places = [bench.devices.get(name).identity()["port"] for name in ("imu", "imu_arm")]
        records = bench.observe(0.5, feedback="odometry").records
    assert len(set(places)) == 2
    assert all(samples(records, name) for name in ("imu", "imu_arm"))


def test_only_those_that_are_named_are_served(file, monkeypatch, capsys):
    served = []
    monkeypatch.setattr("hil.fakes.server.EmulationServer.run", lambda self, ready=None: served.append(self))
    assert main(["emulate", "--bench", file(IMUS), "--only", "imu_arm"]) == 0
    assert {*json.loads(capsys.readouterr().out)} == {"imu_arm"}
    for server in served:
        for transport in server.transports.values():
            transport.close()
    assert main(["emulate", "--bench", file(IMUS), "--only", "imu_leg"]) == 2
    assert "imu, imu_arm" in capsys.readouterr().err


@pytest.mark.usefixtures("ranges")
def test_discovery_writes_a_file_with_both(file, tmp_path, monkeypatch):
    monkeypatch.setattr("can.detect_available_configs", lambda interfaces: [])
    config = load_bench(file(RANGES))
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    ports = [c.values["port"] for c in connected.connections.values()]
    text = discover(VirtualClock(world), ports=ports, sysfs=tmp_path).to_toml()
    connected.close()
    (tmp_path / "found.toml").write_text(text)
    assert [table["name"] for table in tomllib.loads(text)["rangefinder"]] == ["rangefinder", "second"]
    found = load_bench(tmp_path / "found.toml").devices()
    assert {name: table.port for name, table in found.items()} == dict(
        zip(("rangefinder", "rangefinder_second"), ports, strict=True)
    )


@pytest.mark.usefixtures("ranges")
def test_a_configuration_is_the_same_when_it_is_written_and_read_again(file, tmp_path):
    first = load_bench(file(RANGES, IMUS), overrides={"imu_arm.fail_after_s": 7.0})
    assert [*first.devices()] == ["imu", "imu_arm", "rangefinder_front", "rangefinder_rear"]
    assert (first.imu.fail_after_s, first.imu_arm.fail_after_s) == (3.0, 7.0)
    again = tmp_path / "again.toml"
    again.write_text(tomli_w.dumps(first.model_dump(mode="json", by_alias=True, exclude_none=True)))
    assert load_bench(again) == first == load_bench(first)
    assert load_bench(first, emulate="rangefinder_rear,imu_body") == first
    without = load_bench(first, overrides={"imu_arm": None, "rangefinder_front": None})
    assert [*without.devices()] == ["imu", "rangefinder_rear"]


def one(kind, *lines):
    return "\n".join((f"[[{kind}]]", *lines, ""))


WRONG = {
    "a name is missing": (one("imu", 'name = "a"', REAL.format(1)) + one("imu"), "imu[1].name: missing"),
    "a name is there twice": (
        one("imu", 'name = "a"', REAL.format(1)) + one("imu", 'name = "a"'),
        "imu[1].name: 'a' is the name of another imu",
    ),
    "a name is none": (one("imu", 'name = "2 nd"'), "imu[0].name: '2 nd' is no name"),
    "two that move the robot": (
        one("servos", 'name = "a"') + one("servos", 'name = "b"'),
        "servos: found 2 of them; there may be one",
    ),
    "no tables": ("imu = [1, 2]\n", "imu: expected [imu], or [[imu]]"),
    "a key that is none": (
        one("imu", 'name = "a"') + one("imu", 'name = "b"', REAL.format(2), "baut = 9600"),
        "imu_b.baut: unknown key; did you mean baud?",
    ),
    "one port for both": (
        one("imu", 'name = "a"', REAL.format(1)) + one("imu", 'name = "b"', REAL.format(1)),
        "imu_b.port",
    ),
    "a table that is no device": ("[imu_b]\n" + REAL.format(1), "imu_b: unknown key"),
    "a truth of none": (IMUS + "[emulation.imu_leg]\n", "emulation.imu_leg: unknown key"),
    "wheel speeds for two cameras": (
        "[servos]\n" + one("tracker", 'name = "a"') + one("tracker", 'name = "b"', "wheel_odometry = true"),
        "tracker_b.wheel_odometry: only the camera [tracker]",
    ),
}


@pytest.mark.parametrize(("tables", "why"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_named(tables, why, tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(HEAD.format(tables))
    with pytest.raises(ConfigError) as error:
        load_bench(path)
    assert why in str(error.value)


@pytest.mark.usefixtures("ranges")
def test_a_truth_that_belongs_to_none_of_the_two_is_refused(file):
    with pytest.raises(ConfigError, match=r"emulation\.rangefinder: .*emulation\.rangefinder_front, "):
        load_bench(file(RANGES, "[emulation.rangefinder]\nplate_x_m = 1.0\n"))


def test_a_fault_of_a_device_that_is_not_there_is_refused(file):
    with pytest.raises(FaultNotSupportedError, match="imu_leg:off: no emulated device of that name"):
        hil.open_bench(file(IMUS), faults="imu_leg:off")


def test_a_package_whose_table_has_a_name_of_its_own_is_refused(package, forget, monkeypatch):
    source = PACKAGE.replace("port: int = 47000", 'name: Literal["x"] = "x"') + "\nITEM = thing()\n"
    monkeypatch.setattr(sys, "path", [str(package("own-name", source, "ITEM")), *sys.path])
    forget()
    with pytest.raises(ConfigError, match="has a key `name` of its own"):
        load_bench("emulated")
