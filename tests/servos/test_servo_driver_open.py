"""What the driver says of a bus that is not as expected, and what it makes of one that others have used."""

import re

import numpy as np
import pytest
from servo_client import ALL, TABLE, word

from hil.cli.setup import command as setup
from hil.config.servo_models.x_series_codes import BAUD_RATES
from hil.config.servos import ServosConfig
from hil.core.clock import MonotonicClock
from hil.core.errors import DeviceError, DeviceTimeoutError
from hil.core.signals import ServoSetpoint, Status
from hil.drivers.servos.dynamixel.commissioning import set_up
from hil.drivers.servos.dynamixel.driver import DynamixelServos
from hil.drivers.servos.dynamixel.packets import instruction


@pytest.mark.parametrize(
    "port", ["/dev/nonexistent", "/dev/null", "/", "hil://absent", "nonsense://x", "socket://127.0.0.1:9"]
)
def test_a_port_that_cannot_be_opened_is_a_device_error(port):
    driver = DynamixelServos(ServosConfig(port=port), MonotonicClock())
    with pytest.raises(DeviceError, match="port cannot be opened") as caught:
        driver.open()
    assert caught.value.device == "servos"
    assert caught.value.port == port
    assert caught.value.expected
    assert caught.value.remedy
    driver.close()


def test_a_busy_port_says_so(servo_bench):
    bench = servo_bench()
    with pytest.raises(DeviceError, match="close the other program"):
        DynamixelServos(bench.config, bench.clock).open()
    bench.driver.close()
    DynamixelServos(bench.config, bench.clock).open()


@pytest.mark.parametrize("baud", [min(BAUD_RATES.values()), max(BAUD_RATES.values())])
def test_the_wrong_baud_rate_is_recognised(servo_bench, baud):
    with pytest.raises(DeviceTimeoutError, match=f"servos answer at {baud} baud"):
        servo_bench(baud=baud)


def test_a_bus_without_power_is_silent(servo_bench):
    with pytest.raises(DeviceTimeoutError, match=r"8 of 8 servos(.|\n)*has power"):
        servo_bench("servos:off")


def test_a_bus_that_is_just_starting_is_waited_for(servo_bench):
    bench = servo_bench("servos:brownout@0+0.1")
    assert bench.driver.read()[0].ok


def test_missing_and_wrong_servos_are_in_one_table(servo_bench):
    with pytest.raises(DeviceError) as caught:
        servo_bench(
            absent=frozenset({2, 7}),
            model_by_joint={0: 1030},
            firmware_by_joint={4: 30},
            ids=(1, 2, 3, 4, 5, 6, 7, 8),
        )
    text = str(caught.value)
    assert "4 of 8 servos" in text
    assert "drive_FL (ID 1): found model 1030 (XM430-W210), firmware 46" in text
    assert "drive_BL (ID 2): found nothing" in text
    assert "steer_FL (ID 5): found model 1010 (XH430-W210), firmware 30" in text
    assert "steer_BR (ID 7): found nothing" in text
    assert "update the firmware" in text
    assert "hil discover" in text


def test_another_model_than_the_bench_file_names_is_refused(servo_bench):
    """The bench file can guard against an exchanged servo."""
    with pytest.raises(DeviceError, match=r"expected model 1010(.|\n)*set servos\.model_number = 1000"):
        servo_bench(model_number=1000, config={"model_number": 1010})


def test_servos_too_old_for_the_bus_watchdog_are_refused(servo_bench):
    with pytest.raises(DeviceError, match=r"firmware 37(.|\n)*update the firmware"):
        servo_bench(firmware=37, config={"min_firmware": 0})


def test_two_servos_with_one_id_are_recognised(servo_bench):
    with pytest.raises(DeviceError, match="two servos may share this ID"):
        servo_bench(ids=(1, 2, 3, 3, 5, 6, 7, 8), config={"drive_ids": (1, 2, 3, 4)})


@pytest.mark.parametrize(
    ("joint", "register", "raw", "said"),
    [
        (0, "operating_mode", 3, r"drive_FL \(ID 1\): operating_mode 3"),
        (4, "operating_mode", 2, "operating_mode 2"),
        (1, "drive_mode", 1, "drive_mode 1, expected 0"),
        (6, "homing_offset", 100, "homing_offset 100, expected 0"),
    ],
)
def test_an_eeprom_that_does_not_fit_is_reported_and_left_alone(servo_bench, joint, register, raw, said):
    with pytest.raises(DeviceError, match=rf"not set up for this bench(.|\n)*{said}(.|\n)*hil setup"):
        servo_bench(eeprom={joint: {register: raw}})


@pytest.mark.parametrize(
    ("modes", "first"),
    [
        ({0: 3, 4: 1}, "drive_FL (ID 1) and steer_FL (ID 5) have each other's operating mode"),
        ({0: 3, 1: 3, 4: 1, 5: 1}, "drive_FL (ID 1), drive_BL (ID 2) and steer_FL (ID 5), steer_BL (ID 6)"),
        ({0: 3}, "nothing is written"),
        ({0: 3, 1: 3, 4: 1}, "nothing is written"),
    ],
)
def test_exchanged_ids_are_named_before_any_register(servo_bench, modes, first):
    """Written into the EEPROM, the mode of a drive would let a steering axis turn without end."""
    with pytest.raises(DeviceError) as caught:
        servo_bench(eeprom={joint: {"operating_mode": mode} for joint, mode in modes.items()})
    remedy = caught.value.remedy
    assert remedy.startswith(first)
    exchanged = not first.startswith("nothing")
    assert ("if the IDs in the bench file are right, write them" in remedy) is exchanged
    if len(modes) == 2 and exchanged:
        drive, steer = (str(joint + 1) for joint in modes)
        assert f"first exchange {drive} in servos.drive_ids and {steer} in servos.steer_ids" in remedy


def test_the_commands_that_are_printed_set_the_servos_up(servo_bench):
    bench = servo_bench(
        eeprom={0: {"operating_mode": 3}, 6: {"homing_offset": 100, "drive_mode": 1}}, open_driver=False
    )
    with pytest.raises(DeviceError) as caught:
        bench.driver.open()
    printed = re.findall(r"`hil setup (.+?)`", caught.value.remedy)
    assert len(printed) == 2
    for words in printed:
        given = setup.make_context("setup", words.split()).params
        registers = {name: int(value) for name, value in (pair.split("=") for pair in given["pairs"])}
        set_up(
            given["port"], bench.clock, baud=given["baud"], servo_id=given["servo_id"], registers=registers
        )
    bench.driver.open()
    assert bench.driver.read()[0].ok


@pytest.mark.parametrize("level", [0, 1])
def test_servos_left_silent_are_made_to_answer(servo_bench, level):
    bench = servo_bench(open_driver=False)
    for servo in bench.bus.servos:
        servo.write(TABLE["status_return_level"].address, bytes((level,)))
    bench.driver.open()
    assert bench.driver.read()[0].ok


@pytest.mark.parametrize(
    ("options", "config", "fast"),
    [({}, {}, True), ({"firmware_by_joint": {3: 44}}, {}, False), ({}, {"fast_sync_read": False}, False)],
)
def test_fast_reads_are_used_where_every_servo_has_them(servo_bench, options, config, fast):
    bench = servo_bench(config=config, **options)
    reads = next(f for f in bench.driver.diagnose() if f.check == "reads")
    assert reads.found == ("fast sync read" if fast else "plain sync read")
    for _ in range(20):
        assert bench.driver.read()[0].ok
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000_000)
    assert bench.driver.read_health() == ()
    assert bench.driver.read()[0].ok
    (health,) = bench.driver.read_health()
    np.testing.assert_allclose(health.voltage_v, 11.1, atol=0.1)
    np.testing.assert_allclose(health.temperature_c, 27.0, atol=1.0)


def test_a_held_robot_stays_held_when_it_is_opened(servo_bench):
    """Torque on and steering turned: opening neither drops torque nor moves anything."""
    bench = servo_bench(open_driver=False)
    for servo in bench.bus.servos:
        servo.write(TABLE["torque_enable"].address, b"\x01")
        if servo.joint >= 4:
            servo.write(TABLE["goal_position"].address, (2500).to_bytes(4, "little"))
    bench.clock.sleep_until_ns(1_000_000_000)
    before = bench.plant.position.copy()
    bench.driver.open()
    assert all(s.torque for s in bench.bus.servos)
    assert "bulk write" in next(f.found for f in bench.driver.diagnose() if f.check == "goals")
    bench.driver.enable()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 150_000_000)
    np.testing.assert_allclose(bench.plant.position, before, atol=0.005)
    start = before[4:]
    for _ in range(100):
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.full(4, 1.0), start + 0.2))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    (sample,) = bench.driver.read()
    np.testing.assert_allclose(sample.velocity_rad_s[:4], 1.0, atol=0.05)
    np.testing.assert_allclose(sample.position_rad[4:], start + 0.2, atol=0.01)


def test_ram_registers_of_the_bench_file_are_written_and_restored_after_a_restart(servo_bench):
    bench = servo_bench(
        "servo.drive_FL:reset@2",
        config={"drive_registers": {"velocity_p_gain": 123}, "steer_registers": {"profile_velocity": 77}},
    )
    bench.driver.enable()
    gain = bench.bus.servos[0].table
    assert (gain.get("velocity_p_gain"), bench.bus.servos[5].table.get("profile_velocity")) == (123, 77)
    while bench.clock.now_ns() < 4_000_000_000:
        bench.driver.read()
        bench.driver.read_health()
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    assert gain.get("velocity_p_gain") == 123
    assert gain.get("bus_watchdog") == 4
    assert gain.get("torque_enable") == 1


def test_steering_in_extended_mode_turns_further(servo_bench):
    bench = servo_bench(config={"steer_mode": "extended", "steer_limit_rad": 7.0}, steer_mode=4)
    bench.driver.enable()
    for _ in range(400):
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.zeros(4), np.array([6.5, -6.5, 0.0, 7.5])))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    (sample,) = bench.driver.read()
    np.testing.assert_allclose(sample.position_rad[4:], [6.5, -6.5, 0.0, 7.0], atol=0.01)


def test_findings_tell_what_could_be_better(servo_bench):
    bench = servo_bench(
        return_delay=250,
        eeprom={j: {"shutdown": 0} for j in range(8)},
        firmware=44,
        supply_v=9.0,
        latency_s=0.016,
        open_driver=False,
    )
    bench.clock.sleep_until_ns(300_000_000)
    bench.driver.open()
    found = {f.check: f for f in bench.driver.diagnose()}
    assert found["return delay"].level == "warning"
    assert "500 us" in found["return delay"].found
    assert found["reads"].level == "warning"
    assert found["shutdown"].level == "warning"
    assert found["hardware errors"].level == "failure"
    assert "drive_FL: input voltage" in found["hardware errors"].found
    assert found["reply time"].level == "warning"
    assert "latency timer" in found["reply time"].remedy
    assert all(
        "--port hil://servos --baud 1000000 --id 1 --register" in found[c].remedy
        for c in ("return delay", "shutdown")
    )


def test_limits_in_the_eeprom_below_those_of_the_bench_are_reported_with_a_remedy(servo_bench):
    bench = servo_bench(eeprom={2: {"velocity_limit": 20}, 5: {"max_position_limit": 2500}})
    (limits,) = (f for f in bench.driver.diagnose() if f.check == "limits")
    assert limits.level == "warning"
    assert "wheels 0.48 rad/s, steering" in limits.found
    assert "velocity_limit, min_position_limit and max_position_limit" in limits.remedy


def test_a_bus_in_order_has_no_failures(servo_bench):
    levels = {f.check: f.level for f in servo_bench().driver.diagnose()}
    assert {c for c, level in levels.items() if level != "ok"} <= {"limits"}


def test_a_closed_driver_refuses_and_closing_twice_is_fine(servo_bench):
    bench = servo_bench()
    bench.driver.close()
    bench.driver.close()
    assert bench.driver.identity() == {}
    bench.driver.stop()
    for use in (
        bench.driver.read,
        bench.driver.enable,
        bench.driver.release,
        bench.driver.diagnose,
        bench.driver.read_health,
    ):
        with pytest.raises(DeviceError, match="used while closed"):
            use()


def test_a_second_client_on_the_bus_never_makes_a_wrong_number(servo_bench):
    """Somebody else pings and reads through the same adapter at odd times."""
    bench = servo_bench()
    bench.driver.enable()
    rng = np.random.default_rng(3)
    still = bench.driver.read()[0].position_rad
    seen = set()
    for k in range(300):
        if k % 3 == 0:
            packet = instruction(int(rng.integers(1, 9)), 2, word(128) + word(10))
            packet = instruction(ALL, 1) if k % 2 else packet
            bench.line.send(packet[: int(rng.integers(5, len(packet) + 1))], 1_000_000)
        (sample,) = bench.driver.read()
        seen |= set(sample.status)
        good = [j for j in range(8) if sample.status[j] is Status.OK]
        np.testing.assert_allclose(sample.position_rad[good], still[good], atol=0.01)
        assert all(np.isnan(sample.position_rad[j]) for j in range(8) if j not in good)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + int(rng.integers(1, 10_000_000)))
    assert Status.OK in seen


def test_opening_never_writes_to_the_eeprom(servo_bench):
    bench = servo_bench(open_driver=False)
    before = [bytes(s.table.data[:64]) for s in bench.bus.servos]
    bench.driver.open()
    bench.driver.enable()
    bench.driver.release()
    bench.driver.close()
    assert [bytes(s.table.data[:64]) for s in bench.bus.servos] == before


def test_garbled_answers_in_the_first_moment_are_asked_for_again(servo_bench):
    """What a killed program has asked for may still be on its way; no servo is refused for that."""
    bench = servo_bench("servos:corrupt@0+0.15,probability=1")
    assert bench.driver.identity()


@pytest.mark.parametrize(
    ("model", "name", "config"), [(1060, "1060 (XL430-W250)", {}), (7, "7", {"model_number": 1010})]
)
def test_a_servo_without_a_control_table_is_refused_by_name(servo_bench, model, name, config):
    with pytest.raises(DeviceError) as caught:
        servo_bench(model_by_joint={3: model}, config=config)
    text = str(caught.value)
    assert f"drive_FR (ID 4): found model {name}, firmware 46" in text
    assert "exchange the servo: units and ranges are known of 1000 (XH430-W350), 1010 (XH430-W210)" in text


def test_a_register_that_a_servo_refuses_is_named(servo_bench):
    with pytest.raises(DeviceError, match=r"servo 1: register at 102 cannot be written .*limit below"):
        servo_bench(config={"drive_registers": {"goal_current": 500}}, eeprom={0: {"current_limit": 400}})
