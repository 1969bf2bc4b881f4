"""Finding servos whatever they are set to, and setting one up without harm."""

import pytest

from hil.core.errors import DeviceError, UsageError
from hil.drivers.servos.dynamixel.commissioning import FoundServo, scan, set_up

PORT = "hil://servos"


@pytest.fixture
def bus_of(servo_bench):
    """Factory of a bus whose line is free; returns the bench."""

    def build(*faults, **options):
        return servo_bench(*faults, open_driver=False, **options)

    return build


def test_a_scan_finds_all_at_the_slowest_rate(bus_of):
    bench, baud = bus_of(baud=9_600), 9_600
    found = scan(PORT, bench.clock, ids=range(10))
    assert found == tuple(FoundServo(i, baud, 1010, 46, 1 if i <= 4 else 3, 0.0) for i in range(1, 9))
    assert bench.clock.now_ns() < 3_000_000_000


def test_a_full_scan_takes_seconds_not_minutes(bus_of):
    bench = bus_of(ids=(1, 2, 3, 4, 5, 6, 7, 252))
    assert [s.servo_id for s in scan(PORT, bench.clock)] == [1, 2, 3, 4, 5, 6, 7, 252]
    assert bench.clock.now_ns() < 12_000_000_000


def test_a_scan_reports_different_rates_and_delays(bus_of):
    bench = bus_of(eeprom={2: {"baud_rate": 1, "return_delay_time": 250}, 3: {"baud_rate": 7}})
    found = {s.servo_id: s for s in scan(PORT, bench.clock, ids=range(10))}
    assert {i: s.baud for i, s in found.items()} == dict.fromkeys(range(1, 9), 1_000_000) | {
        3: 57_600,
        4: 4_500_000,
    }
    assert found[3].return_delay_s == pytest.approx(500e-6)


def test_a_scan_asks_only_what_is_given(bus_of):
    bench = bus_of()
    assert [s.servo_id for s in scan(PORT, bench.clock, bauds=(1_000_000,), ids=(2, 5, 9))] == [2, 5]
    assert scan(PORT, bench.clock, bauds=(57_600,)) == ()
    assert scan(PORT, bench.clock, ids=()) == ()
    with pytest.raises(UsageError, match="123 is not one of the servo's"):
        scan(PORT, bench.clock, bauds=(123,))
    with pytest.raises(DeviceError, match="cannot be opened"):
        scan("hil://absent", bench.clock)


def test_an_adapter_that_is_pulled_during_a_scan_is_an_error(bus_of):
    bench = bus_of("servos:unplug@0.001")
    with pytest.raises(DeviceError, match="the port is gone"):
        scan(PORT, bench.clock, ids=range(5))


def test_set_up_writes_registers_then_id_then_rate(bus_of):
    bench = bus_of()
    changed = set_up(
        PORT,
        bench.clock,
        baud=1_000_000,
        servo_id=3,
        new_id=33,
        new_baud=3_000_000,
        registers={"return_delay_time": 2, "velocity_limit": 230, "operating_mode": 1},
    )
    assert changed == {
        "return_delay_time": (0, 2),
        "velocity_limit": (210, 230),
        "operating_mode": (1, 1),
        "id": (3, 33),
        "baud_rate": (3, 5),
    }
    servo = bench.bus.servos[2]
    assert (servo.id, servo.baud, servo.table.get("velocity_limit")) == (33, 3_000_000, 230)
    (found,) = scan(PORT, bench.clock, bauds=(3_000_000,), ids=range(40))
    assert (found.servo_id, found.return_delay_s) == (33, pytest.approx(4e-6))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"registers": {"goal_position": 1}}, "goal_position is not a register that can be set up"),
        ({"registers": {"nonsense": 1}}, "nonsense is not a register"),
        ({"registers": {"model_number": 1}}, "model_number is not a register"),
        ({"registers": {"return_delay_time": 255}}, r"return_delay_time = 255.*0\.\.254"),
        ({"registers": {"operating_mode": 2}}, "one of 0, 1, 3, 4, 5, 16"),
        ({"new_id": 253}, r"id = 253.*0\.\.252"),
        ({"new_baud": 123}, "123 is not one of the servo's"),
        ({"baud": 123}, "123 is not one of the servo's"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_written(bus_of, arguments, message):
    bench = bus_of()
    before = [bytes(s.table.data) for s in bench.bus.servos]
    with pytest.raises(UsageError, match=message):
        set_up(PORT, bench.clock, **{"baud": 1_000_000, "servo_id": 3, **arguments})
    assert [bytes(s.table.data) for s in bench.bus.servos] == before


def test_a_servo_with_torque_on_is_not_touched(bus_of):
    bench = bus_of()
    bench.bus.servos[2].write(64, b"\x01")
    with pytest.raises(DeviceError, match=r"servo 3 has torque on.*release torque"):
        set_up(PORT, bench.clock, baud=1_000_000, servo_id=3, registers={"return_delay_time": 5})


@pytest.mark.parametrize("other", [1, 8])
def test_a_taken_id_is_not_given_twice(bus_of, other):
    bench = bus_of()
    with pytest.raises(DeviceError, match=f"ID {other} is taken"):
        set_up(PORT, bench.clock, baud=1_000_000, servo_id=3, new_id=other)


def test_a_value_that_does_not_stay_is_an_error(bus_of):
    """The servo loses power at some moment of the procedure, also between writing and reading back."""
    said = set()
    for tenths_ms in range(0, 60, 5):
        bench = bus_of(f"servo.3:off@{tenths_ms * 1e-4}")
        try:
            set_up(PORT, bench.clock, baud=1_000_000, servo_id=3, registers={"return_delay_time": 5})
        except DeviceError as error:
            said.add(error.message.split(": ", 1)[1])
        bench.line.close()
    texts = " ".join(said)
    for part in ("cannot be read", "return_delay_time cannot be written", "= 5 did not stay"):
        assert part in texts


def test_a_refused_rename_is_an_error(bus_of):
    """Another client switches torque on just before the ID is written: the EEPROM is locked."""
    bench = bus_of()
    began = bench.clock.now_ns()
    set_up(PORT, bench.clock, baud=1_000_000, servo_id=1, registers={"moving_threshold": 11})
    reading_ns = bench.clock.now_ns() - began

    class Meddler:
        due_ns = bench.clock.now_ns() + reading_ns // 3

        def next_due_ns(self):
            return self.due_ns

        def on_due(self, t_ns):
            self.due_ns = 1 << 62
            bench.bus.servos[2].write(64, b"\x01")

    bench.world.add(Meddler())
    with pytest.raises(DeviceError, match=r"servo 3: id cannot be written .*does not let"):
        set_up(PORT, bench.clock, baud=1_000_000, servo_id=3, new_id=30)
