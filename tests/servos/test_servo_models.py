"""Servo models: the laws of their tables, the vendor's figures, and each of them behind the real driver."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from servo_client import MODEL
from servo_wire import make_wire

from hil.config.servo_models import servo_model, shared_register
from hil.config.servo_models.x_series_codes import BAUD_RATES, RETURN_DELAY_STEP_S, WATCHDOG_STEP_S
from hil.config.servos import ServosConfig
from hil.core.errors import UsageError
from hil.core.signals import ServoSetpoint
from hil.drivers.servos.dynamixel.commissioning import scan, set_up
from hil.drivers.servos.dynamixel.register_map import RegisterMap
from hil.drivers.servos.dynamixel.servo_samples import ALL_SERVOS, MultiTurnCounter

NUMBERS = (1000, 1010, 1020, 1030, 1040, 1050)
PORT = "hil://servos"
# e-Manual: name, A per count, current limit, velocity limit, voltage limits, position P gain
VENDOR = {
    1000: ("XH430-W350", 2.69e-3, 648, 130, (95, 160), 900),
    1010: ("XH430-W210", 2.69e-3, 648, 210, (95, 160), 900),
    1020: ("XM430-W350", 2.69e-3, 1193, 200, (95, 160), 800),
    1030: ("XM430-W210", 2.69e-3, 1193, 330, (95, 160), 800),
    1040: ("XH430-V350", 1.34e-3, 689, 135, (110, 300), 800),
    1050: ("XH430-V210", 1.34e-3, 689, 230, (110, 300), 800),
}
# e-Manual, at the recommended voltage: V, stall N m, stall A, no-load rev/min, gear ratio
SPECIFIED = {
    1000: (12.0, 3.4, 1.3, 30, 353.5),
    1010: (12.0, 2.5, 1.3, 50, 212.6),
    1020: (12.0, 4.1, 2.3, 46, 353.5),
    1030: (12.0, 3.0, 2.3, 77, 212.6),
    1040: (24.0, 3.3, 0.7, 31, 353.5),
    1050: (24.0, 2.6, 0.7, 52, 212.6),
}

each_model = pytest.mark.parametrize("number", NUMBERS)


def supply_v(number):
    """What a bench would give it: the robot's battery, or 24 V."""
    return 11.1 if servo_model(number).recommended_v == 12.0 else 24.0


@pytest.fixture
def bench_of(servo_bench):
    """Factory of a driver on a bus of one model that the bench file does not name."""

    def build(number, *faults, **values):
        return servo_bench(*faults, model_number=number, **values)

    return build


@each_model
def test_registers_do_not_overlap_and_lie_in_their_areas(number):
    model = servo_model(number)
    by_address = sorted(model.table.values(), key=lambda r: r.address)
    for before, after in itertools.pairwise(by_address):
        assert before.end <= after.address, (before.name, after.name)
    assert by_address[0].address == 0
    assert by_address[-1].end == model.table_size
    torque = model.table["torque_enable"].address
    for name, register in model.table.items():
        assert name == register.name
        assert register.size in (1, 2, 4)
        assert register.eeprom == (register.address < torque), name


@each_model
def test_defaults_fit_their_registers_and_ranges(number):
    table = servo_model(number).table
    for name, register in table.items():
        assert register.decode(register.encode(register.default)) == register.default, name
        assert register.permits(register.default), name
        if register.limit:
            assert abs(register.default) <= table[register.limit].default, name
        if register.writable and not register.values and not register.limit:
            assert register.low < register.high, name
            for raw in (register.low, register.high):
                assert register.decode(register.encode(raw)) == raw, name
    assert table["model_number"].default == number
    assert (table["baud_rate"].low, table["baud_rate"].high) == (min(BAUD_RATES), max(BAUD_RATES))


@each_model
def test_units_that_the_code_relies_on_are_those_of_the_table(number):
    model = servo_model(number)
    assert model.table["bus_watchdog"].scale == WATCHDOG_STEP_S
    assert model.table["return_delay_time"].scale == RETURN_DELAY_STEP_S
    assert model.rad_per_count * model.counts_per_turn == pytest.approx(2.0 * math.pi)
    assert model.rad_s_per_count == pytest.approx(0.229 * 2.0 * math.pi / 60.0, rel=1e-3)
    assert {model.table[n].scale for n in ("current_limit", "goal_current", "present_current")} == {
        model.a_per_count
    }


@pytest.mark.parametrize(
    "name", ["model_number", "firmware_version", "status_return_level", "torque_enable", "backup_ready"]
)
def test_what_is_asked_before_the_model_is_known_is_at_one_place_in_all(name):
    assert shared_register(name).address == servo_model(1010).table[name].address


@each_model
def test_figures_are_the_vendors(number):
    model, table = servo_model(number), servo_model(number).table
    name, a_per_count, current, velocity, (low, high), gain = VENDOR[number]
    assert (model.name, model.a_per_count) == (name, a_per_count)
    assert (table["current_limit"].default, table["current_limit"].high) == (current, current)
    assert table["goal_current"].default == current
    assert table["velocity_limit"].default == velocity
    for voltage, default in (("min_voltage_limit", low), ("max_voltage_limit", high)):
        register = table[voltage]
        assert (register.default, register.low, register.high) == (default, low, high)
    assert table["position_p_gain"].default == gain
    volts, torque, current_a, rpm, ratio = SPECIFIED[number]
    (row,) = [r for r in model.performance if r.supply_v == volts]
    assert (row.stall_torque_n_m, row.stall_current_a, row.no_load_rpm) == (torque, current_a, rpm)
    assert (model.recommended_v, model.gear_ratio) == (volts, ratio)


@each_model
def test_the_emulated_motor_gives_the_vendors_stall_and_no_load_rows(number):
    """At every listed voltage, with the emulated gear's friction."""
    model = servo_model(number)
    motor, coulomb, viscous = model.motor, 0.04, 0.023
    for row in model.performance:
        stall_a = row.supply_v / motor.resistance_ohm
        assert stall_a == pytest.approx(row.stall_current_a, rel=0.08)
        assert motor.torque_constant_n_m_a * stall_a == pytest.approx(row.stall_torque_n_m, rel=0.08)
        drop = motor.resistance_ohm / motor.torque_constant_n_m_a
        top = (row.supply_v - drop * coulomb) / (motor.back_emf_v_s_rad + drop * viscous)
        assert top == pytest.approx(row.no_load_rad_s, rel=0.06)


def test_what_a_bench_writes_at_open_must_be_right_for_the_model_on_the_bus():
    with pytest.raises(ValueError, match=r"position_p_gain = 20000"):
        ServosConfig(drive_registers={"position_p_gain": 20_000})
    assert ServosConfig(model_number=1040, drive_registers={"goal_current": 100}).model_number == 1040


@each_model
def test_the_driver_takes_the_model_that_is_on_the_bus(bench_of, number):
    bench = bench_of(number)
    assert bench.driver.model is servo_model(number)
    assert bench.driver.identity()["model"] == f"{VENDOR[number][0]} ({number})"


@each_model
def test_currents_come_back_in_amperes(bench_of, number):
    """Of a motor that draws 0.4 A and one that draws -0.25 A."""
    bench = bench_of(number)
    bench.plant.load_a[:] = [0.4, -0.25, *[0.0] * 6]
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000_000)
    current = bench.driver.read()[0].current_a
    np.testing.assert_allclose(current[:2], [0.4, -0.25], atol=VENDOR[number][1])
    shown = [bench.bus.servos[j].table.get("present_current") for j in (0, 1)]
    assert shown == [int(0.4 / VENDOR[number][1]), int(-0.25 / VENDOR[number][1])]


@each_model
def test_goals_stay_within_the_servos_own_limits(bench_of, number):
    bench = bench_of(number, config={"velocity_limit_rad_s": 7.0})
    bench.driver.enable()
    bench.driver.command(ServoSetpoint(np.array([100.0, -100.0, 0.0, 1.0]), np.zeros(4)))
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    goals = [bench.bus.servos[j].table.get("goal_velocity") for j in range(4)]
    top = min(VENDOR[number][3], int(7.0 / 0.0239691227))
    assert goals == [top, -top, 0, 42]


@each_model
def test_positions_velocities_and_supply_come_back_as_they_are(bench_of, number):
    bench = bench_of(number, config={"health_period_s": 0.05})
    bench.driver.enable()
    for _ in range(60):
        bench.driver.read()
        bench.driver.command(ServoSetpoint(np.full(4, 1.5), np.array([0.5, -0.5, 0.0, 1.0])))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000_000)
    sample = bench.driver.read()[0]
    assert sample.ok
    np.testing.assert_allclose(sample.velocity_rad_s[:4], 1.5, atol=0.04)
    np.testing.assert_allclose(sample.position_rad, bench.plant.position + _starts(bench), atol=0.02)
    (health,) = bench.driver.read_health()
    np.testing.assert_allclose(health.voltage_v, supply_v(number), atol=0.15)


def _starts(bench):
    starts = np.array(bench.bus.options.drive_start_counts) - 2048
    return np.concatenate((starts * bench.driver.model.rad_per_count, np.zeros(4)))


@each_model
def test_a_supply_for_the_other_kind_is_a_hardware_error(servo_bench, number):
    """10.5 V are too little for a servo of 24 V, and 24 V too much for one of 12 V."""
    made_for_24_v = servo_model(number).recommended_v == 24.0
    for volts, wrong in ((10.5, made_for_24_v), (24.0, not made_for_24_v)):
        bench = servo_bench(model_number=number, supply_v=volts)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 200_000_000)
        assert {s.table.get("hardware_error_status") for s in bench.bus.servos} == {int(wrong)}
        bench.line.close()


@each_model
def test_a_scan_and_a_setup_go_by_the_model_that_answers(bench_of, number):
    bench = bench_of(number, open_driver=False)
    found = scan(PORT, bench.clock, bauds=(1_000_000,), ids=range(10))
    assert {(s.model, s.firmware) for s in found} == {(number, 46)}
    assert [s.operating_mode for s in found] == [1] * 4 + [3] * 4
    low, high = VENDOR[number][4]
    values = {
        "current_limit": VENDOR[number][2] - 1,
        "min_voltage_limit": low + 1,
        "max_voltage_limit": high - 1,
    }
    reported = set_up(PORT, bench.clock, baud=1_000_000, servo_id=3, new_id=20, registers=values)
    assert reported == {
        "current_limit": (VENDOR[number][2], VENDOR[number][2] - 1),
        "min_voltage_limit": (low, low + 1),
        "max_voltage_limit": (high, high - 1),
        "id": (3, 20),
    }
    servo = bench.bus.servos[2]
    assert {name: servo.table.get(name) for name in values} == values


@pytest.mark.parametrize(
    ("number", "register", "raw", "said"),
    [
        (1010, "max_voltage_limit", 300, r"95\.\.160 for XH430-W210"),
        (1050, "min_voltage_limit", 95, r"110\.\.300 for XH430-V210"),
        (1010, "current_limit", 1193, r"0\.\.648 for XH430-W210"),
        (1040, "current_limit", 690, r"0\.\.689 for XH430-V350"),
    ],
)
def test_a_setup_refuses_what_another_model_would_take(bench_of, number, register, raw, said):
    bench = bench_of(number, open_driver=False)
    before = bytes(bench.bus.servos[0].table.data)
    with pytest.raises(UsageError, match=rf"{register} = {raw}; expected {said}"):
        set_up(PORT, bench.clock, baud=1_000_000, servo_id=1, registers={register: raw})
    assert bytes(bench.bus.servos[0].table.data) == before


def test_a_register_that_the_firmware_lacks_is_refused_by_servo_and_setup(servo_bench):
    bench = servo_bench(firmware=44, open_driver=False)
    address = servo_model(1010).table["startup_configuration"].address
    assert bench.bus.servos[0].write(address, b"\x01") == 7  # access
    with pytest.raises(
        UsageError, match="startup_configuration: the servo has firmware 44; expected firmware 45"
    ):
        set_up(PORT, bench.clock, baud=1_000_000, servo_id=1, registers={"startup_configuration": 1})
    newer = make_wire(firmware=45).bus.servos[0]
    assert newer.write(address, b"\x01") == 0


def test_how_fast_a_servo_can_turn_is_the_models():
    """9 rad/s for half a second: no XH430-W210 does that, an XM430-W210 does."""
    for number, started_over in ((1010, True), (1030, False)):
        model = servo_model(number)
        turns = MultiTurnCounter(model)
        everybody, still = np.ones(8, dtype=bool), np.zeros(8)
        turns.follow(np.zeros(8, dtype=np.int64), still, everybody, 0)
        moved = np.full(8, round(9.0 * 0.5 / model.rad_per_count), dtype=np.int64)
        _, jumped = turns.follow(moved, still, everybody, 500_000_000)
        assert jumped.all() == jumped.any() == started_over


@given(
    st.lists(
        st.tuples(st.lists(st.integers(-9000, 9000), min_size=8, max_size=8), st.integers(0, 7)), max_size=8
    )
)
@example([([0] * 8, 4), ([0] * 8, 0)])  # a restart before the first reading: there is nothing to bridge
def test_turns_are_counted_alike_whether_all_are_looked_at_together_or_each(readings):
    """Restarts (steps of thousands of counts), and one servo that is silent now and then."""
    together, each = MultiTurnCounter(MODEL), MultiTurnCounter(MODEL)
    for k, (raw, silent) in enumerate(readings):
        seen = ALL_SERVOS
        if silent == 3:
            seen = ALL_SERVOS.copy()
            seen[3] = False
        elif silent == 4:
            together.restarted(4)
            each.restarted(4)
        reading = np.array(raw), np.zeros(8)
        one = together.follow(*reading, seen, 10_000_000 * k)
        other = each.follow(*reading, seen.copy(), 10_000_000 * k)
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
        np.testing.assert_array_equal(together.offset, each.offset)


def test_a_range_that_is_read_in_one_go_must_be_one():
    """A table whose current, velocity and position are apart needs another driver, not wrong numbers."""
    model = servo_model(1010)
    table = {**model.table, "present_velocity": model.table["velocity_trajectory"]}
    with pytest.raises(LookupError, match="not neighbours"):
        RegisterMap(type(model)(**{**vars(model), "table": table}))
