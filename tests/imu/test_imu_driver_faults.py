"""Every failure of the emulated BNO055 ends as data with a status, a repair, or a named device error."""

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from hil.core.errors import DataError, DeviceError, DeviceTimeoutError
from hil.core.signals import Status
from hil.drivers.imu.bno055.calibration import ImuCalibration
from hil.fakes.serial_chip import Reply
from tests.selected import draws

MODE_WRITE = bytes.fromhex("AA003D0108")


def run(bench, duration_s, period_ns=10_000_000):
    samples, t_ns = [], bench.clock.now_ns()
    end_ns = t_ns + round(duration_s * 1e9)
    while bench.clock.now_ns() < end_ns:
        samples += bench.driver.read()
        t_ns = max(t_ns + period_ns, bench.clock.now_ns())
        bench.clock.sleep_until_ns(t_ns)
    return samples


def statuses(samples):
    return {s.status for s in samples}


def test_bus_overruns_are_repeated_within_the_cycle(imu_bench):
    bench = imu_bench(overrun_probability=0.25, config={"fusion_mode": "ndof"})
    bench.driver.open()
    samples = run(bench, 5)
    good = sum(s.status is Status.OK for s in samples)
    assert good > 0.98 * len(samples)
    assert len(samples) > 400


@pytest.mark.parametrize("fault", ["imu:reset@1", "imu:brownout@1+0.2", "imu:off@1+0.2"])
def test_a_silent_chip_reset_is_noticed_and_repaired(imu_bench, fault):
    bench = imu_bench(fault, config={"axis_map": 0x21, "axis_sign": 0x04})
    bench.driver.open()
    samples = run(bench, 3)
    kinds = [s.status for s in samples]
    assert {Status.OK, Status.TIMEOUT, Status.RESET} <= set(kinds)
    back = kinds.index(Status.RESET)
    assert samples[back].stamp.t_ns < 2_000_000_000
    assert set(kinds[back + 5 :]) == {Status.OK}
    assert samples[-1].gravity_m_s2[0] == pytest.approx(9.8, abs=0.1)
    assert bench.written.count(MODE_WRITE) == 2
    assert bench.chip.opr_mode == 8


@pytest.mark.parametrize("prefetch", [False, True])
@pytest.mark.parametrize(
    "fault", ["imu:reset@1", "imu:corrupt@1+2,probability=0.5", "imu:drop@1+2,probability=0.5"]
)
def test_no_repair_holds_up_a_control_cycle(imu_bench, fault, prefetch):
    """A repair over a damaged wire once held up the loop for a quarter of a second, again and again."""
    bench = imu_bench(fault, config={"prefetch": prefetch})
    bench.driver.open()
    took_ns, usable = [], []
    for _ in range(400):
        began_ns = bench.clock.now_ns()
        usable += [s.status is Status.OK for s in bench.driver.read()]
        took_ns.append(bench.clock.now_ns() - began_ns)
        bench.clock.sleep_until_ns(max(bench.clock.now_ns(), began_ns + 10_000_000))
    assert max(took_ns) < 20_000_000
    assert all(usable[-20:])
    assert bench.written.count(MODE_WRITE) == (2 if "reset" in fault else 1)


def test_a_reset_that_is_not_heard_is_found_in_the_data(imu_bench):
    """The chip reboots between two reads: it answers at once, with zeros."""
    bench = imu_bench(config={"check_period_s": 100})
    bench.driver.open()
    run(bench, 0.5)
    bench.chip.reset(bench.clock.now_ns())
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 700_000_000)
    kinds = [s.status for s in run(bench, 0.5)]
    assert kinds[0] is Status.STARTING
    assert kinds[1] is Status.RESET
    assert kinds[-1] is Status.OK


def test_calibration_goes_back_into_the_chip_after_a_reset(imu_bench, tmp_path):
    ImuCalibration((1, -2, 3), (4, 5, -6), (7, 8, 9), 1000, 480).save(tmp_path / "imu.toml")
    bench = imu_bench("imu:reset@1", config={"calibration_file": str(tmp_path / "imu.toml")})
    bench.driver.open()
    run(bench, 3)
    assert bench.driver.read_calibration().accelerometer_offset == (1, -2, 3)
    assert run(bench, 0.2)[-1].status is Status.OK


def test_a_calibration_file_is_used_from_the_start(imu_bench, tmp_path):
    known = ImuCalibration((10, -20, 30), (4, 5, -6), (7, 8, 9), 1000, 480)
    path = tmp_path / "imu.toml"
    known.save(path)
    assert ImuCalibration.load(path) == known
    bench = imu_bench(config={"calibration_file": str(path)})
    bench.driver.open()
    assert bench.driver.read_calibration() == known
    hexfile = tmp_path / "imu.hex"
    hexfile.write_text(known.to_bytes().hex(" ", 2))
    assert ImuCalibration.load(hexfile) == known


@pytest.mark.parametrize("text", ["", "zz", "00" * 21, "a = 1", "accelerometer_offset = [1, 2", "x\0y"])
def test_a_bad_calibration_file_is_a_data_error_naming_it(imu_bench, tmp_path, text):
    path = tmp_path / "bad.cal"
    path.write_text(text)
    with pytest.raises(DataError, match="22 bytes") as caught:
        imu_bench(config={"calibration_file": str(path)}).driver.open()
    assert str(path) in str(caught.value)


def test_frozen_data_are_marked(imu_bench):
    bench = imu_bench("imu:stuck@1+2")
    bench.driver.open()
    kinds = [s.status for s in run(bench, 4)]
    assert kinds.count(Status.FROZEN) == pytest.approx(180, abs=10)
    assert kinds[-1] is Status.OK


@pytest.mark.parametrize("fault", ["off", "garbage", "intermittent", "stuck"])
def test_lasting_failure_raises_with_port_and_remedy(imu_bench, fault):
    options = ",duty=1" if fault == "intermittent" else ""
    bench = imu_bench(f"imu:{fault}@1{options}", config={"fail_after_s": 1.5})
    bench.driver.open()
    run(bench, 1.2)
    with pytest.raises(DeviceTimeoutError, match="nothing usable") as caught:
        run(bench, 5)
    assert caught.value.port == "chip://imu"
    assert "PS1" in str(caught.value)
    assert bench.clock.now_ns() < 4_000_000_000


@pytest.mark.parametrize("prefetch", [False, True])
@pytest.mark.parametrize(
    "fault", ["imu:drop@1.0+0.009", "imu:slow@1.0+0.009,answer_s=0.008", "imu:slow@1.0+0.009,answer_s=0.012"]
)
def test_a_reply_that_is_lost_or_late_costs_one_sample(imu_bench, fault, prefetch):
    """The late reply once passed for the answer to the next request, which was lost with it."""
    bench = imu_bench(fault, config={"prefetch": prefetch}, overrun_probability=0.0)
    bench.driver.open()
    run(bench, 0.5)
    samples = run(bench, 1)
    lost = [s for s in samples if s.status is not Status.OK]
    assert {s.status for s in lost} <= {Status.TIMEOUT}
    assert len(lost) <= 1
    assert len(samples) >= 98
    assert max(np.diff([s.stamp.t_ns for s in samples if s.status is Status.OK])) < 30_000_000


@pytest.mark.parametrize("prefetch", [False, True])
def test_every_fifth_reply_lost_costs_every_fifth_sample(imu_bench, prefetch):
    bench = imu_bench("imu:drop@0.5,probability=0.2", config={"prefetch": prefetch}, overrun_probability=0.0)
    bench.driver.open()
    run(bench, 0.5)
    usable = sum(s.status is Status.OK for s in run(bench, 10))
    assert usable > 0.75 * 1000


def test_a_late_reply_is_no_answer_to_its_own_repetition(imu_bench):
    """The second reply once stayed in the port: every later sample was the one before, stamped "now"."""
    fault, config = "imu:slow@1+0.1,answer_s=0.012", {"retry_budget_s": 0.05}
    bench = imu_bench(fault, config=config, overrun_probability=0.0)
    bench.driver.open()
    run(bench, 1.2)
    ages_ns = [s.stamp.host_ns - s.stamp.t_ns for s in run(bench, 0.2)]
    assert min(ages_ns) > 8_000_000, "half a fusion period, and 3.5 ms on the wire"


def test_silence_costs_little_time_per_cycle(imu_bench):
    bench = imu_bench("imu:off@1")
    bench.driver.open()
    run(bench, 1)
    t_ns, spent_ns = bench.clock.now_ns(), 0
    for _ in range(100):
        before_ns = bench.clock.now_ns()
        bench.driver.read()
        spent_ns += bench.clock.now_ns() - before_ns
        t_ns += 10_000_000
        bench.clock.sleep_until_ns(t_ns)
    assert spent_ns < 100 * 3_000_000


@pytest.mark.parametrize("code", [2, 7, 99])
def test_error_replies_are_protocol_samples(imu_bench, code):
    bench = imu_bench(f"imu:intermittent@0.5,code={code}")
    bench.driver.open()
    samples = run(bench, 2)
    assert Status.PROTOCOL in statuses(samples)
    assert samples[-1].status is Status.OK or samples[-1].status is Status.PROTOCOL
    assert all(np.isnan(s.gyro_rad_s).all() for s in samples if s.status is Status.PROTOCOL)


def test_wrong_slow_delayed_and_jump(imu_bench, turning_plant):
    bench = imu_bench(
        "imu:wrong@1+1,rate_rad_s=0.5",
        "imu:slow@3+1,factor=10",
        "imu:delayed@5+1,delay_s=0.2",
        "imu:jump@7+0.1,angle_rad=0.4",
        plant=turning_plant(tilt_rad=0.0),
    )
    bench.driver.open()
    run(bench, 0.9)
    before = run(bench, 0.5)[-1]
    assert before.gyro_rad_s[2] == pytest.approx(0.5, abs=0.02)
    run(bench, 1.7)
    slow = run(bench, 0.9)
    distinct = {s.gyro_rad_s.tobytes() + s.linear_acceleration_m_s2.tobytes() for s in slow}
    assert 6 <= len(distinct) <= 12
    run(bench, 1.2)
    bench.plant.rate_rad_s = 1.0
    assert run(bench, 0.1)[-1].gyro_rad_s[2] < 0.1
    assert run(bench, 0.4)[-1].gyro_rad_s[2] == pytest.approx(1.0, abs=0.02)
    bench.plant.rate_rad_s = 0.0
    run(bench, 1.0)
    yaw = bench.chip.sensors.yaw_error_rad
    run(bench, 1.0)
    assert bench.chip.sensors.yaw_error_rad - yaw == pytest.approx(0.4, abs=0.001)
    assert run(bench, 0.1)[-1].status is Status.OK


def test_slow_answers_are_lost_when_slower_than_the_time_out(imu_bench):
    bench = imu_bench("imu:slow@1,answer_s=0.04")
    bench.driver.open()
    run(bench, 1.2)
    assert statuses(run(bench, 1)) == {Status.TIMEOUT}


@pytest.mark.parametrize(
    ("url", "remedy"),
    [
        ("chip://denied", "dialout"),
        ("chip://absent", "discover"),
        ("/dev/no_such_tty", "discover"),
        ("/", "discover"),
    ],
)
def test_a_port_that_cannot_be_opened(imu_bench, url, remedy):
    with pytest.raises(DeviceError, match=remedy) as caught:
        imu_bench(config={"port": url}).driver.open()
    assert caught.value.port == url
    assert caught.value.exit_code == 3


def test_no_answer_at_the_wrong_baud_rate(imu_bench):
    bench = imu_bench(config={"baud": 9600})
    with pytest.raises(DeviceTimeoutError, match="9600 baud"):
        bench.driver.open()
    assert bench.clock.now_ns() < 3_000_000_000
    assert bench.driver.identity() == {}


def test_open_waits_for_a_booting_chip(imu_bench):
    bench = imu_bench()
    bench.chip.reset(0)
    bench.driver.open()
    assert 0.65e9 < bench.clock.now_ns() < 0.8e9


class Impostor:
    """Answers requests with the next of a list of byte strings; None is the real chip's answer."""

    def __init__(self, chip, answers, only=b""):
        self.chip, self.answers, self.only = chip, list(answers), only

    def receive(self, data, t_ns, baud):
        replies = self.chip.receive(data, t_ns, baud)
        if not data.startswith(self.only):
            return replies
        answer = self.answers.pop(0) if self.answers else None
        return replies if answer is None else [Reply(t_ns, answer)]


def test_another_device_is_named_with_expected_and_found(imu_bench):
    bench = imu_bench()
    answers = [bytes.fromhex("EE01"), bytes.fromhex("BB07A0FB330F000000")] * 200
    bench.interpose(Impostor(bench.chip, answers))
    with pytest.raises(DeviceError, match="magnetometer 0x32 found 0x33"):
        bench.driver.open()


class WithSystemError:
    """A chip whose next reply with registers 0x39 and 0x3A says a system error."""

    def __init__(self, chip):
        self.chip, self.said = chip, False

    def receive(self, data, t_ns, baud):
        replies = self.chip.receive(data, t_ns, baud)
        if data == bytes.fromhex("AA01142A") and replies and not self.said:
            self.said, reply = True, bytearray(replies[0].data)
            reply[2 + 0x39 - 0x14 : 2 + 0x3B - 0x14] = b"\x01\x03"
            return [Reply(replies[0].ready_ns, bytes(reply))]
        return replies


def test_a_system_error_is_reported(imu_bench):
    bench = imu_bench(overrun_probability=0.0)
    bench.driver.open()
    bench.interpose(WithSystemError(bench.chip))
    kinds = [s.status for s in run(bench, 3)]
    assert kinds.count(Status.HARDWARE_ERROR) == pytest.approx(100, abs=3)
    assert kinds[-1] is Status.OK


@pytest.mark.parametrize("counts", [(5000, 0, 0, 0, 980), (16384, 0, 0, 0, 500)])
def test_an_impossible_attitude_is_implausible(imu_bench, counts):
    w, x, y, z, up = counts
    data = b"".join(
        v.to_bytes(2, "little", signed=True) for v in (0, 0, 0, 0, 0, 0, w, x, y, z, 0, 0, 0, 0, 0, up)
    )
    bench = imu_bench()
    bench.driver.open()
    bench.interpose(Impostor(bench.chip, [bytes((0xBB, 34)) + data + b"\x1b\xff"]))
    assert bench.driver.read()[0].status is Status.IMPLAUSIBLE


@draws(60, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(st.lists(st.none() | st.binary(max_size=200), max_size=40), st.integers(0, 12))
def test_garbage_of_any_length_never_hangs_and_never_escapes(imu_bench, answers, skip):
    bench = imu_bench(config={"open_timeout_s": 0.5, "fail_after_s": 0.4})
    bench.interpose(Impostor(bench.chip, [None] * skip + answers))
    with contextlib.suppress(DeviceError):
        bench.driver.open()
        for _ in range(60):
            for sample in bench.driver.read():
                assert isinstance(sample.status, Status)
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 5_000_000)
    bench.driver.close()
    assert bench.clock.now_ns() < 20_000_000_000


@pytest.mark.parametrize("prefetch", [False, True])
def test_a_port_that_has_gone_shows_at_once_and_the_chip_is_set_up_anew(imu_bench, prefetch):
    bench = imu_bench(config={"prefetch": prefetch})
    bench.driver.open()
    before = run(bench, 0.2)[-1]
    bench.unplug()
    run(bench, 0.3)
    assert bench.driver.port_gone
    with pytest.raises(DeviceError):
        bench.driver.reopen()
    assert not bench.driver.port_gone
    bench.plug()
    bench.driver.reopen()
    after = run(bench, 0.3)
    assert (after[0].status, after[-1].status) == (Status.RESET, Status.OK)
    assert after[0].stamp.seq > before.stamp.seq


@pytest.mark.parametrize("prefetch", [False, True])
def test_a_port_pulled_out_is_data_then_an_error_and_can_come_back(imu_bench, prefetch):
    bench = imu_bench(config={"prefetch": prefetch})
    bench.driver.open()
    run(bench, 0.2)
    bench.unplug()
    already_received = 1 if prefetch else 0
    assert statuses(run(bench, 0.5)[already_received:]) == {Status.TIMEOUT}
    bench.plug()
    assert run(bench, 0.3)[-1].status is Status.OK
    bench.unplug()
    with pytest.raises(DeviceTimeoutError, match="the port failed"):
        run(bench, 10)
    bench.driver.close()
    bench.driver.close()


def test_a_chip_that_refuses_its_set_up_does_not_open(imu_bench):
    bench = imu_bench()
    refuse = [bytes.fromhex("EE03")] * 500
    bench.interpose(Impostor(bench.chip, refuse, only=bytes.fromhex("AA003D")))
    with pytest.raises(DeviceError, match=r"cannot be set up.*0x03"):
        bench.driver.open()
    assert bench.driver.identity() == {}


def test_a_second_client_that_changes_the_page_is_repaired(imu_bench):
    bench = imu_bench()
    bench.driver.open()
    run(bench, 0.3)
    bench.chip.receive(bytes.fromhex("AA00070101"), bench.clock.now_ns(), 115_200)
    kinds = [s.status for s in run(bench, 0.5)]
    assert Status.RESET in kinds
    assert kinds[-1] is Status.OK


def test_the_flow_of_the_common_public_client_is_understood(imu_bench):
    """Identity, reset, ranges on page 1, NDOF, single-register reads, as hobby libraries do it."""
    bench = imu_bench(overrun_probability=0.0, acknowledge_reset=False)

    def ask(text, wait_ms=1.0):
        now_ns = bench.clock.now_ns()
        bench.world.sync_plant()
        reply = b"".join(r.data for r in bench.chip.receive(bytes.fromhex(text), now_ns, 115_200))
        bench.clock.sleep_until_ns(now_ns + round(wait_ms * 1e6))
        return reply.hex()

    assert ask("AA010001") == "bb01a0"
    assert ask("AA003F0120", 700) == ""
    assert ask("AA010001") == "bb01a0"
    for setting in ("3E0100", "070100", "3F0100", "070101", "08010D", "0A0138", "09016D", "070100"):
        assert ask("AA00" + setting) == "ee01"
    assert ask("AA003D0100", 20) == "ee01"
    assert ask("AA003D010C", 10) == "ee01"
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 50_000_000)
    for register, length in (("35", 1), ("34", 1), ("1A", 6), ("20", 8), ("28", 6), ("2E", 6), ("0E", 6)):
        reply = ask(f"AA01{register}{length:02X}")
        assert reply.startswith(f"bb{length:02x}")
        assert len(reply) == 2 * (length + 2)


def test_open_is_patient_with_a_busy_computer_and_a_cycle_is_not(imu_bench):
    bench = imu_bench("imu:slow@0,answer_s=0.03")
    bench.driver.open()
    began_ns = bench.clock.now_ns()
    assert {sample.status for sample in bench.driver.read()} == {Status.TIMEOUT}
    assert bench.clock.now_ns() - began_ns < 50_000_000


def test_a_missing_calibration_file_is_a_data_error(imu_bench):
    with pytest.raises(DataError, match="cannot be read"):
        imu_bench(config={"calibration_file": "/no/such/file"}).driver.open()


def test_calibration_access_reports_a_dead_chip(imu_bench):
    bench = imu_bench("imu:off@1")
    bench.driver.open()
    bench.clock.sleep_until_ns(1_100_000_000)
    with pytest.raises(DeviceTimeoutError, match="cannot be read"):
        bench.driver.read_calibration()
