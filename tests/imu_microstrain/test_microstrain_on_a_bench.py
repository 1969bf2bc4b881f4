"""The whole robot with a MicroStrain sensor: chosen in the bench file, driven, recorded, examined."""

import numpy as np
import pytest
import tomli_w

import hil
from hil.bench.doctor.discovery import discover
from hil.bench.doctor.examination import examine
from hil.bench.emulated_devices import build_world, connect_in_process
from hil.cli import main
from hil.config.imu import Bno055Config
from hil.config.loading import load_bench, validate
from hil.config.microstrain import MicrostrainConfig
from hil.core.errors import ConfigError
from hil.core.signals import Status
from hil.drivers.imu.microstrain.model import MicroStrain
from hil.fakes.world import VirtualClock
from hil.recording.mcap_writer import McapRecorder
from hil.replay.recordings import open_recording
from hil.replay.verification import verify_recording
from hil.robot.trajectories import line

pytestmark = pytest.mark.usefixtures("warm_commands")

IMU = {"model": "microstrain", "backend": "emulated"}
ALONE = {"schema": 1, "name": "sensor", "imu": IMU}
CLIMB = line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), duration_s=2.0)
SHORT = line((0.0, 0.0, 0.0), (0.03, 0.0, 0.0), duration_s=1.0)


@pytest.fixture
def bench_file(tmp_path):
    """A bench file with this sensor alone, and these lines more."""

    def write(more=""):
        path = tmp_path / "bench.toml"
        path.write_text(
            'schema = 1\nname = "sensor"\n[imu]\nmodel = "microstrain"\nbackend = "emulated"\n' + more
        )
        return path

    return write


def wall(**options):
    """The whole robot on its wall; nothing but the inertial unit is another one."""
    return hil.open_bench("emulated", overrides={"imu": IMU}, **options)


def test_the_bench_file_chooses_the_model():
    config = load_bench("emulated", overrides={"imu": IMU})
    assert isinstance(config.of(MicrostrainConfig), MicrostrainConfig)
    with pytest.raises(
        ConfigError, match=r"imu: model 'microstran' is unknown; .*did you mean microstrain\?"
    ):
        validate({**ALONE, "imu": {**IMU, "model": "microstran"}}, "it")


def test_an_override_of_the_model_leaves_out_what_only_the_other_has():
    """The shipped profile has `prefetch = true`, which is a matter of the BNO055's bursts."""
    config = load_bench("emulated", overrides={"imu.model": "microstrain", "imu.rate_hz": 100.0})
    table = config.of(MicrostrainConfig)
    assert (table.backend, table.rate_hz) == ("emulated", 100.0)
    for overrides in ({"imu.model": "microstrain", "imu.prefetch": True}, {"imu.rate_hz": 100.0}):
        with pytest.raises(ConfigError, match="unknown key"):
            load_bench("emulated", overrides=overrides)
    assert load_bench("emulated", overrides={"imu.model": "bno055"}).of(Bno055Config).prefetch


@pytest.mark.parametrize(
    ("keys", "reported"),
    [
        ({"prefetch": True}, "imu.prefetch: unknown key; remove it or check the spelling"),
        ({"magnetometr": True}, "imu.magnetometr: unknown key; did you mean magnetometer?"),
        ({"axis_map": 0x24}, "imu.axis_map: unknown key; remove it"),
        ({"rate_hz": 300}, "imu.rate_hz: .*at most 119 Hz, or set sensor and bench to 921600 baud"),
    ],
)
def test_hints_are_those_of_the_chosen_model(keys, reported):
    with pytest.raises(ConfigError) as caught:
        validate({**ALONE, "imu": {**IMU, **keys}}, "it")
    assert len(caught.value.problems) == 1
    assert caught.match(reported)


def test_imperfections_are_those_of_the_chosen_model(bench_file):
    bench = hil.open_bench(bench_file("[emulation.imu]\ngyro_bias_rad_s = 0.5\n"))
    bench.close()
    with pytest.raises(ConfigError, match=r"emulation\.imu\.yaw_drift_rad_s: unknown"):
        hil.open_bench(bench_file("[emulation.imu]\nyaw_drift_rad_s = 0.5\n"))


def test_up_a_wall_with_it_in_virtual_time_and_in_a_replay_bit_for_bit(tmp_path):
    path = tmp_path / "climb.mcap"
    bench = wall(seed=2)
    bench.add_sink(McapRecorder(path, bench.header(), lossless=True))
    with bench:
        motion = bench.drive(CLIMB, feedback="ekf", hold_s=0.3)
        truth = bench.truth().pose_body_in_wall
        samples = [s for r in motion.records for s in r.inputs.imu]
    assert not motion.events
    assert len(samples) == pytest.approx(2.3 * 111.1, rel=0.05)
    assert {s.status for s in samples} == {Status.OK}
    np.testing.assert_allclose(motion.estimate[-1][:2], truth[:2], atol=0.005)
    assert motion.estimate[-1][2] == pytest.approx(truth[2], abs=0.005)
    assert truth[0] == pytest.approx(0.1, abs=0.01)
    recording = open_recording(path)
    assert isinstance(recording.bench.config.of(MicrostrainConfig), MicrostrainConfig)
    found = verify_recording(recording)
    assert found["verdict"] == "identical"
    assert sum(run["cycles"] for run in found["runs"]) > 220


@pytest.mark.long
def test_the_same_seed_gives_the_same_drive():
    def driven(seed):
        with wall(seed=seed) as bench:
            return np.array(bench.drive(SHORT, feedback="ekf").estimate).tobytes()

    assert driven(4) == driven(4)
    assert driven(4) != driven(5)


@pytest.mark.alone
@pytest.mark.long
def test_up_a_wall_with_it_at_the_wire_in_real_time():
    with wall(seed=1, realtime=True) as bench:
        motion = bench.drive(line((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), duration_s=2.0), hold_s=0.5)
        measured = motion.mocap[np.isfinite(motion.mocap[:, 0])][-1]
        assert np.linalg.norm(motion.estimate[-1][:2] - measured[:2]) < 0.01
        statuses = [s.status for r in motion.records for s in r.inputs.imu]
        assert statuses.count(Status.OK) > 0.9 * 2.5 * 111
        assert not motion.events


def test_a_fault_of_it_is_seen_and_survived():
    with wall(seed=2, faults=("imu:off@1.0+0.2",)) as bench:
        motion = bench.drive(CLIMB, feedback="ekf", hold_s=0.3)
        statuses = {s.status for r in motion.records for s in r.inputs.imu}
        np.testing.assert_allclose(motion.estimate[-1][:2], bench.truth().pose_body_in_wall[:2], atol=0.01)
    assert Status.TIMEOUT in statuses
    assert any("imu" in event.source for event in motion.events)


def findings(bench):
    return {f.check: f for f in examine(bench, watch_s=1.0) if f.device == "imu"}


def test_the_doctor_finds_it_healthy(bench_file):
    found = findings(hil.open_bench(bench_file()))
    assert {f.level for f in found.values()} == {"ok"}
    assert "3DM-CV7-AHRS" in found["open"].found
    assert found["samples"].found.startswith("111 of 110 good")
    assert found["filter"].found == "vertical gyro, stable"
    assert found["rate"].found == "111.1 Hz, 0 gaps"
    assert found["gravity"].found == "9.78 m/s^2"
    assert found["late samples"].found == "0 of 111"


@pytest.mark.parametrize(
    ("fault", "check", "level", "reported"),
    [
        ("imu:off", "open", "failure", "no MicroStrain sensor answers"),
        ("imu:slow@0.3,factor=3", "rate", "warning", "37.0 Hz"),
        ("imu:delayed@1.2,delay_s=0.07", "late samples", "failure", " of "),
        ("imu:stuck@0.2", "samples", "failure", "frozen"),
        ("imu:reset@0.5", "filter", "failure", "initialising"),
    ],
)
def test_the_doctor_names_what_is_wrong(bench_file, fault, check, level, reported):
    more = "[emulation.imu]\ninitialisation_s = 5\n" if "reset" in fault else ""
    found = findings(hil.open_bench(bench_file(more), faults=(fault,)))[check]
    assert (found.level, reported in found.found) == (level, True), found
    assert found.remedy


@pytest.mark.parametrize(("baud", "reported"), [(115_200, ""), (921_600, "baud = 921600\n")])
def test_discovery_finds_it_and_its_file_opens(baud, reported, tmp_path):
    config = validate({**ALONE, "imu": {**IMU, "baud": baud}}, "it")
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    port = connected.connections["imu"].values["port"]
    text = discover(VirtualClock(world), ports=[port], sysfs=tmp_path).to_toml()
    connected.close()
    assert f'[imu]\nmodel = "microstrain"\nport = "{port}"\n{reported}' in text
    file = tmp_path / "found.toml"
    file.write_text(text)
    assert load_bench(file).of(MicrostrainConfig).baud == baud


def test_a_bno055_is_not_taken_for_it():
    config = validate({**ALONE, "imu": {"backend": "emulated"}}, "it")
    world = build_world(config, seed=1)
    connected = connect_in_process(config, world)
    port = connected.connections["imu"].values["port"]
    assert MicroStrain().probe(port, VirtualClock(world)) is None
    connected.close()


def test_the_calibration_of_a_bno055_is_refused_for_it(tmp_path, capsys):
    path = tmp_path / "bench.toml"
    tree = load_bench("emulated", overrides={"imu.model": "microstrain"}).model_dump(
        mode="json", by_alias=True, exclude_unset=True, exclude_none=True
    )
    path.write_text(tomli_w.dumps(tree))
    assert main(["run", "imu_calibration", "--bench", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "keeps no offsets for a client to store" in capsys.readouterr().out
