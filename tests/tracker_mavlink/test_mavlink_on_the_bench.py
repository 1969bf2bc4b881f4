"""`model = "mavlink"`: the whole bench with that tracker, in virtual time and at the wire."""

import json
import pickle

import numpy as np
import pytest

import hil
from hil.bench.emulated_devices import open_emulation
from hil.cli import main
from hil.config.loading import load_bench
from hil.core.clock import MonotonicClock
from hil.core.device import Search
from hil.core.errors import ConfigError
from hil.core.registry import kinds
from hil.core.signals import Status
from hil.fakes.serial_line import SerialLine
from hil.fakes.serial_pty import SerialPty
from hil.fakes.tracker.mavlink.chip import ComputerTruthOptions
from hil.fakes.tracker.mavlink.links import MavlinkTransport, SerialComputer
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_run
from hil.robot.trajectories import line
from tests.tracker_mavlink.test_mavlink_links import BAUD, serving

pytest.importorskip("pymavlink", reason="the extra mavlink is not installed")
pytestmark = [
    pytest.mark.timeout(900),  # the first process to start may compile the estimators
    pytest.mark.usefixtures("warm_commands"),
]

SIDEWAYS = line((0.0, 0.0, 0.0), (0.0, 0.2, 0.0), duration_s=4.0)
"""The robot sags on its way along the wall, which no wheel sees."""
SHORT = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), duration_s=2.0)
MODEL = {"tracker.model": "mavlink"}


def drive(*faults, trajectory=SIDEWAYS, recorder=None, **overrides):
    bench = hil.open_bench("emulated", seed=1, faults=faults, overrides={**MODEL, **overrides})
    if recorder is not None:
        bench.add_sink(McapRecorder(recorder, bench.header(), lossless=True))
    with bench:
        motion = bench.drive(trajectory, hold_s=0.2)
        return motion, np.linalg.norm(motion.estimate[-1][:2] - bench.truth().pose_body_in_wall[:2])


def tracker_samples(motion):
    return [s for r in motion.records for s in r.inputs.tracker]


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Path of the recording of a drive along the wall, the drive, and how far off its estimate ends."""
    path = tmp_path_factory.mktemp("sideways") / "drive.mcap"
    return path, *drive(recorder=path)


def test_the_wall_is_driven_by_it_and_the_recording_repeats_bit_for_bit(driven):
    path, motion, error_m = driven
    samples = tracker_samples(motion)
    assert len(samples) == pytest.approx(100 * len(motion.records) / 100, rel=0.05)
    assert {s.status for s in samples} == {Status.OK}
    assert error_m < 0.003
    opened = open_recording(path)
    assert [verify_run(opened.bench, run)["difference"] for run in opened.runs] == [None, None]
    assert opened.bench.config.tracker.model == "mavlink"


@pytest.mark.long
def test_the_estimate_needs_it_and_the_same_seed_gives_the_same_bits(driven):
    first, again = (drive(trajectory=SHORT) for _ in range(2))
    logs = [
        pickle.dumps([(r.inputs, r.state.pose_body_in_wall) for r in m.records]) for m, _ in (first, again)
    ]
    assert logs[0] == logs[1]
    blind_m = drive(**{"estimator.tracker.use": "off"})[1]
    assert blind_m > 3.0 * driven[2]


@pytest.mark.parametrize("distance_m", [0.015, pytest.param(0.3, marks=pytest.mark.long)])
def test_a_correction_of_the_senders_map_is_reported_and_the_estimate_stays(distance_m):
    """One that is too small for a gate by far, and one that no gate would miss."""
    motion, error_m = drive(f"tracker:jump@3,distance_m={distance_m}")
    assert Status.RESET in {s.status for s in tracker_samples(motion)}
    assert error_m < 0.004


@pytest.mark.parametrize(
    "way",
    [pytest.param((), id="virtual"), pytest.param(("--realtime",), marks=pytest.mark.real_time, id="wire")],
)
def test_the_doctor_finds_it_healthy(capsys, tmp_path, way):
    bench = tmp_path / "bench.toml"
    bench.write_text('schema = 1\nname = "mavlink"\n[tracker]\nmodel = "mavlink"\nbackend = "emulated"\n')
    assert main(["doctor", "--json", "--watch", "0.5", "--bench", str(bench), *way]) == 0
    findings = json.loads(capsys.readouterr().out)["findings"]
    found = {f["check"]: f["level"] for f in findings if f["device"] == "tracker"}
    assert {"open", "samples", "sender", "time", "frames", "quality", "covariance", "rate"} <= set(found)
    assert len(found) == len([f for f in findings if f["device"] == "tracker"])
    judges_this_computer = {"samples", "time", "rate"} if way else set()  # a busy one is late itself
    others = [f for f in findings if f["device"] == "tracker" and f["check"] not in judges_this_computer]
    assert [f for f in others if f["level"] != "ok"] == []


def test_the_emulator_serves_it_where_the_bench_file_says(tmp_path):
    def endpoint(port):
        bench = load_bench("emulated", overrides={**MODEL, **({"tracker.port": port} if port else {})})
        server = open_emulation(bench, only=["tracker"])
        found = server.endpoints()["tracker"]
        server.close()
        return found

    free = endpoint(None)
    assert free["port"].startswith("udpout:127.0.0.1:")
    assert (free["system_id"], free["component_id"]) == (1, 197)
    assert endpoint(free["port"])["port"] == free["port"]
    assert endpoint("udpin:0.0.0.0:14551")["port"].startswith("udpout:127.0.0.1:")
    serial = endpoint("/dev/ttyUSB0")
    assert serial["port"].startswith("/dev/pts/")
    assert serial["baud"] == BAUD


def test_ids_and_frame_of_the_bench_file_are_those_of_the_emulated_sender():
    overrides = {**MODEL, "tracker.system_id": 9, "tracker.frame": "LOCAL_NED", "tracker.rate_hz": 50.0}
    with hil.open_bench("emulated", seed=1, overrides=overrides) as bench:
        tracker = bench.devices.get("tracker")
        assert tracker.identity()["system"] == "9"
        assert tracker.identity()["frames"] == "LOCAL_NED, BODY_FRD"


@pytest.mark.alone
def test_discovery_finds_a_sender_on_a_serial_port(mavlink_bench):
    bench = mavlink_bench(options=ComputerTruthOptions())
    transport = SerialPty(SerialLine(bench.world, SerialComputer(bench.computer, baud=BAUD)))
    port = transport.endpoint()["port"]
    with serving(bench.world, transport):
        found = kinds()["tracker"].model("mavlink").probe(port, MonotonicClock())
    assert found.table == {"port": port, "system_id": 1, "component_id": 197}
    assert "visual_inertial_odometry" in found.notes[0]


@pytest.mark.alone
def test_discovery_finds_a_sender_at_the_ground_stations_port(mavlink_bench, tmp_path):
    bench = mavlink_bench(options=ComputerTruthOptions())
    transport = MavlinkTransport(bench.computer, target=("127.0.0.1", 14550))
    said = []
    model = kinds()["tracker"].model("mavlink")
    search = Search({}, MonotonicClock(), said.append, tmp_path)
    assert model.search(search) is None
    with serving(bench.world, transport):
        found = model.search(search)
    assert found.table == {"port": "udpin:0.0.0.0:14550", "system_id": 1, "component_id": 197}
    assert said == ["listening for MAVLink odometry at udpin:0.0.0.0:14550"] * 2


def test_keys_of_the_other_model_are_refused():
    with pytest.raises(ConfigError, match=r"tracker\.(mavlink\.)?serial"):
        load_bench("emulated", overrides={**MODEL, "tracker.serial": "17"})
    with pytest.raises(ConfigError, match=r"emulation\.tracker"):
        hil.open_bench("emulated", overrides={**MODEL, "emulation.tracker": {"rate": 5.0}})
