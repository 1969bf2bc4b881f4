"""The emulated servo's control table: rights, ranges, locks, modes, errors, restart, indirect access."""

import pytest
from servo_client import ACTION, BACKUP, CLEAR, FACTORY, PING, READ, REBOOT, REG_WRITE, WRITE, Client

from hil.config.servo_models.x_series_codes import BAUD_RATES
from hil.drivers.servos.dynamixel.packets import find_statuses, instruction
from hil.fakes.servos.dynamixel import protocol


@pytest.fixture
def drive(wire):
    return Client(wire(), 1)


@pytest.fixture
def steer(wire):
    return Client(wire(), 5)


def test_defaults_are_the_vendors(wire):
    client = Client(wire(), 5)
    expected = {
        "model_number": 1010,
        "velocity_limit": 210,
        "current_limit": 648,
        "shutdown": 52,
        "pwm_limit": 885,
        "max_position_limit": 4095,
        "temperature_limit": 80,
        "min_voltage_limit": 95,
        "position_p_gain": 900,
        "velocity_i_gain": 1920,
        "goal_pwm": 885,
        "goal_current": 648,
        "status_return_level": 2,
        "indirect_address_1": 224,
        "indirect_address_28": 251,
        "indirect_address_29": 634,
        "indirect_address_56": 661,
        "present_input_voltage": 111,
        "present_temperature": 27,
    }
    assert {name: client.get(name) for name in expected} == expected


def test_what_is_read_only_undefined_or_out_of_range_is_refused(steer):
    assert steer.put("present_position", 5) == protocol.ACCESS
    assert steer.put("model_number", 5) == protocol.ACCESS
    assert steer.raw(66, [1]) == protocol.ACCESS
    assert steer.raw(660, [0, 0, 0]) == protocol.ACCESS
    assert steer.raw(117, [0, 0, 0, 0]) == protocol.ACCESS
    assert steer.raw(116, [0, 0]) == protocol.DATA_LENGTH
    assert steer.do(WRITE, b"\x74\x00") == (protocol.DATA_LENGTH, b"")
    assert steer.do(READ, b"\x00\x00\xff\x0f") == (protocol.ACCESS, b"")
    assert steer.do(READ, b"\x00") == (protocol.DATA_LENGTH, b"")
    assert steer.put("led", 2) == protocol.DATA_RANGE
    assert steer.put("operating_mode", 2) == protocol.DATA_RANGE
    assert steer.put("secondary_id", 253) == protocol.DATA_RANGE
    assert steer.put("drive_mode", 2) == protocol.DATA_RANGE
    assert steer.put("bus_watchdog", 128) == protocol.DATA_RANGE
    assert steer.put("goal_position", 1_048_576) == protocol.DATA_RANGE
    assert steer.do(0x77) == (protocol.INSTRUCTION_ERROR, b"")


def test_limit_registers_bound_goals(steer):
    assert steer.put("max_position_limit", 3000) == 0
    assert steer.put("goal_position", 3001) == protocol.DATA_LIMIT
    assert steer.put("goal_position", 3000) == 0
    assert steer.put("velocity_limit", 100) == 0
    assert steer.put("goal_velocity", -101) == protocol.DATA_LIMIT
    assert steer.put("goal_velocity", -100) == 0
    assert steer.put("goal_current", 649) == protocol.DATA_LIMIT
    assert steer.put("goal_pwm", -885) == 0


def test_torque_locks_the_eeprom_and_the_indirect_addresses(drive):
    assert drive.put("torque_enable", 1) == 0
    assert drive.put("return_delay_time", 10) == protocol.ACCESS
    assert drive.put("indirect_address_1", 65) == protocol.ACCESS
    assert drive.put("profile_velocity", 10) == 0
    assert drive.put("torque_enable", 0) == 0
    assert drive.put("return_delay_time", 10) == 0


def test_a_wrong_checksum_is_answered_by_the_servo_meant(drive):
    data = bytearray(instruction(1, READ, b"\x84\x00\x04\x00"))
    data[-1] ^= 0x10
    assert find_statuses(drive.bench.send(bytes(data)))[0][1].error == protocol.CRC_ERROR
    data[4] = 77
    assert drive.bench.send(bytes(data)) == b""


def test_registered_writes_wait_for_the_action(drive):
    assert drive.do(ACTION) == (protocol.INSTRUCTION_ERROR, b"")
    assert drive.put("led", 1, REG_WRITE) == 0
    assert drive.put("led", 2, REG_WRITE) == protocol.DATA_RANGE
    assert (drive.get("led"), drive.get("registered_instruction")) == (0, 1)
    assert drive.do(ACTION) == (0, b"")
    assert (drive.get("led"), drive.get("registered_instruction")) == (1, 0)
    drive.put("led", 0, REG_WRITE)
    assert drive.bench.send(instruction(0xFE, ACTION)) == b""
    assert drive.get("led") == 0


def test_status_return_levels(drive):
    assert drive.put("status_return_level", 1) is None
    assert drive.get("led") == 0
    assert drive.put("led", 1) is None
    assert drive.get("led") == 1
    assert drive.put("status_return_level", 0) is None
    assert drive.do(READ, b"\x41\x00\x01\x00") is None
    assert drive.do(PING)[1] == bytes.fromhex("f2032e")


def test_indirect_data_read_and_write_what_they_point_at(steer):
    for k, address in enumerate(range(116, 120), 1):
        assert steer.put(f"indirect_address_{k}", address) == 0
    assert steer.put("indirect_address_5", 65) == 0
    assert steer.put("indirect_address_29", 146) == 0
    assert steer.raw(224, (1234).to_bytes(4, "little") + b"\x01") == 0
    assert (steer.get("goal_position"), steer.get("led")) == (1234, 1)
    assert steer.do(READ, b"\xe0\x00\x05\x00") == (0, (1234).to_bytes(4, "little") + b"\x01")
    assert steer.do(READ, b"\x7a\x02\x01\x00")[1] == b"\x1b"
    assert steer.raw(224, b"\x01\x02") == protocol.DATA_LENGTH
    assert steer.raw(634, b"\x01") == protocol.ACCESS
    assert steer.put("indirect_address_2", 63) == protocol.DATA_RANGE


@pytest.mark.parametrize("code", sorted(BAUD_RATES))
def test_baud_codes_and_silence_at_the_wrong_rate(wire, code):
    client = Client(wire())
    assert client.put("baud_rate", code) == 0
    bench, client.bench.baud = client.bench, BAUD_RATES[code]
    assert client.get("baud_rate") == code
    for other in (250_000, *BAUD_RATES.values()):
        bench.baud = other
        assert (client.do(PING) is not None) == (other == BAUD_RATES[code])
    bench.baud = round(BAUD_RATES[code] * 1.02)
    assert client.do(PING) is not None


def test_a_new_id_and_a_secondary_one(drive):
    assert drive.put("id", 42) == 0
    assert drive.do(PING) is None
    drive.servo_id = 42
    assert drive.put("secondary_id", 7) == 0
    Client(drive.bench, 7).do(WRITE, b"\x41\x00\x01")
    assert drive.get("led") == 1
    other = Client(drive.bench, 50)
    drive.put("secondary_id", 50)
    assert other.do(PING) is None
    drive.bench.send(instruction(0xFE, 0x83, b"\x41\x00\x01\x00\x32\x00"))
    assert drive.get("led") == 0


def test_reboot_forgets_ram_errors_and_turns(drive):
    drive.put("led", 1)
    drive.bench.world.plant.position[0] = 20.0
    assert drive.get("present_position") > 4096
    assert drive.do(REBOOT) == (0, b"")
    assert drive.do(PING) is None
    drive.wait(0.2)
    assert drive.get("led") == 0
    assert 0 <= drive.get("present_position") <= 4095
    assert drive.get("realtime_tick") < 300


@pytest.mark.parametrize(
    ("level", "servo_id", "rate"), [(0xFF, 1, 57_600), (1, 3, 57_600), (2, 3, 1_000_000)]
)
def test_factory_reset_keeps_what_it_is_asked_to(wire, level, servo_id, rate):
    client = Client(wire(), 3)
    client.put("return_delay_time", 3)
    assert client.do(FACTORY, bytes((level,)), wait_ms=200) == (0, b"")
    servo = client.bench.bus.servos[2]
    assert (servo.id, servo.baud, servo.table.get("return_delay_time")) == (servo_id, rate, 250)
    assert servo.table.get("operating_mode") == 3


def test_a_factory_reset_of_everything_for_everybody_is_ignored(drive):
    assert drive.do(FACTORY, b"\x07") == (protocol.DATA_RANGE, b"")
    drive.bench.send(instruction(0xFE, FACTORY, b"\xff"), wait_ns=200_000_000)
    assert [s.id for s in drive.bench.bus.servos] == list(range(1, 9))
    drive.bench.send(instruction(0xFE, FACTORY, b"\x02"), wait_ns=200_000_000)
    assert all(s.table.get("return_delay_time") == 250 for s in drive.bench.bus.servos)


def test_backup_needs_torque_off_the_right_words_and_firmware(wire):
    client = Client(wire())
    assert client.do(BACKUP, b"\x02CTRL") == (protocol.RESULT_FAIL, b"")
    assert client.do(BACKUP, b"\x01XTRL") == (protocol.DATA_RANGE, b"")
    client.put("torque_enable", 1)
    assert client.do(BACKUP, b"\x01CTRL") == (protocol.RESULT_FAIL, b"")
    old = Client(wire(firmware=44))
    assert old.do(BACKUP, b"\x01CTRL") == (protocol.INSTRUCTION_ERROR, b"")


def test_startup_configuration_restores_ram_and_torque(drive):
    drive.put("position_d_gain", 77)
    drive.put("startup_configuration", 3)
    drive.do(BACKUP, b"\x01CTRL")
    drive.put("position_d_gain", 5)
    drive.do(REBOOT, wait_ms=200)
    assert (drive.get("position_d_gain"), drive.get("torque_enable")) == (77, 1)


def test_clear_forgets_turns_only_at_rest(drive):
    drive.bench.world.plant.position[0] = 30.0
    drive.wait(0.2)
    assert drive.get("present_position") > 4095
    assert drive.do(CLEAR, b"\x01DXL\x22") == (0, b"")
    assert 0 <= drive.get("present_position") <= 4095
    assert drive.do(CLEAR, b"\x01DXL\x23") == (protocol.DATA_RANGE, b"")
    drive.put("torque_enable", 1)
    drive.put("goal_velocity", 100)
    drive.wait(0.5)
    assert drive.do(CLEAR, b"\x01DXL\x22") == (protocol.RESULT_FAIL, b"")


def test_a_mode_change_resets_gains_profile_and_goals(drive):
    drive.put("profile_velocity", 5)
    drive.put("goal_pwm", 100)
    drive.put("velocity_p_gain", 7)
    drive.bench.world.plant.position[0] = 30.0
    assert drive.get("present_position") > 4095
    drive.put("operating_mode", 3)
    assert [drive.get(n) for n in ("profile_velocity", "goal_pwm", "velocity_p_gain")] == [0, 885, 100]
    assert 0 <= drive.get("present_position") <= 4095
    drive.put("operating_mode", 16)
    assert drive.get("position_p_gain") == 0


def test_homing_offset_moves_the_present_position(steer):
    before = steer.get("present_position")
    steer.put("homing_offset", 500)
    assert abs(steer.get("present_position") - before - 500) <= 1
    steer.put("homing_offset", 5000)
    assert abs(steer.get("present_position") - before - 1024) <= 1
    steer.put("operating_mode", 4)
    assert abs(steer.get("present_position") - before - 5000) <= 1
    steer.put("torque_enable", 1)
    steer.put("goal_position", 7048)
    steer.wait(1)
    assert abs(steer.bench.world.plant.position[4]) < 0.01


def test_reverse_turns_sign_of_everything(drive):
    drive.put("drive_mode", 1)
    drive.put("torque_enable", 1)
    before = drive.get("present_position")
    drive.put("goal_velocity", 50)
    drive.wait(0.5)
    assert drive.bench.world.plant.velocity[0] == pytest.approx(-50 * 0.0239691227, rel=0.01)
    assert drive.get("present_velocity") in (49, 50)
    assert drive.get("present_position") > before
    assert drive.get("present_current") > 0


def test_torque_on_by_goal_update(drive):
    drive.put("drive_mode", 8)
    drive.put("goal_velocity", 40)
    assert drive.get("torque_enable") == 1
    drive.wait(0.4)
    assert drive.bench.world.plant.velocity[0] > 0.9


def test_overload_shuts_down_until_reboot(steer):
    steer.put("torque_enable", 1)
    steer.bench.world.plant.load_a[4] = 1.25
    steer.wait(3.0)
    assert steer.do(PING)[0] == protocol.ALERT
    assert steer.get("hardware_error_status") == 0x20
    assert steer.get("torque_enable") == 0
    assert steer.bench.world.plant.commands[4].mode == "off"
    steer.put("torque_enable", 1)
    assert steer.get("torque_enable") == 0
    steer.bench.world.plant.load_a[4] = 0.0
    steer.do(REBOOT, wait_ms=200)
    assert steer.do(PING)[0] == 0


def test_heat_and_low_voltage_are_errors_of_their_own(wire):
    hot = Client(wire(ambient_c=82.0), 5)
    hot.wait(0.3)
    assert hot.get("hardware_error_status") == 0x04
    flat = Client(wire(supply_v=9.0), 5)
    flat.put("torque_enable", 1)
    flat.wait(0.3)
    assert flat.get("hardware_error_status") == 0x01
    assert flat.get("torque_enable") == 1
    warm = Client(wire(), 5)
    warm.bench.world.plant.load_a[4] = 1.0
    warm.wait(20)
    assert warm.get("present_temperature") >= 29


def test_the_bus_watchdog_stops_and_refuses_goals_until_cleared(drive):
    drive.put("bus_watchdog", 5)
    drive.put("torque_enable", 1)
    drive.put("goal_velocity", 100)
    for _ in range(30):
        drive.wait(0.05)
        drive.do(PING)
    assert drive.bench.world.plant.velocity[0] > 2
    drive.wait(0.6)
    assert abs(drive.bench.world.plant.velocity[0]) < 0.01
    assert drive.get("bus_watchdog") == -1
    assert drive.get("torque_enable") == 1
    assert drive.put("goal_velocity", 10) == protocol.DATA_RANGE
    assert drive.put("bus_watchdog", 5) == protocol.DATA_RANGE
    assert drive.put("bus_watchdog", 0) == 0
    assert drive.put("goal_velocity", 100) == 0
    drive.wait(0.5)
    assert drive.bench.world.plant.velocity[0] > 2


def test_talk_at_another_rate_is_no_traffic_for_the_watchdog(drive):
    drive.put("bus_watchdog", 5)
    drive.put("torque_enable", 1)
    drive.put("goal_velocity", 100)
    drive.bench.baud = 57_600
    for _ in range(20):
        drive.do(PING)
        drive.wait(0.02)
    drive.bench.baud = 1_000_000
    assert drive.get("bus_watchdog") == -1


@pytest.mark.parametrize("mode", [0, 3, 4, 5, 16])
def test_a_tripped_watchdog_holds_in_every_mode(wire, mode):
    client = Client(wire(), 5)
    client.put("operating_mode", mode)
    client.put("bus_watchdog", 2)
    client.put("torque_enable", 1)
    goal = {0: ("goal_current", 300), 16: ("goal_pwm", 400)}.get(mode, ("goal_position", 3000))
    client.put(*goal)
    client.wait(2.0)
    command = client.bench.world.plant.commands[4]
    assert client.get("bus_watchdog") == -1
    assert command.goal == pytest.approx(
        0.0 if mode in (0, 16) else client.bench.world.plant.position[4], abs=0.35
    )
    assert abs(client.bench.world.plant.velocity[4]) < 0.01
    assert command.mode == {0: "current", 16: "pwm"}.get(mode, "position")


def test_current_based_position_passes_its_limit(wire):
    client = Client(wire(steer_mode=5), 5)
    client.put("goal_current", 100)
    client.put("torque_enable", 1)
    client.put("goal_position", 2500)
    assert client.bench.world.plant.commands[4].current_limit_a == pytest.approx(0.269)
