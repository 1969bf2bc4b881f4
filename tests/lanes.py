"""Which tests run in real time, which alone, and of which like cases some are enough by default.

Tests say it themselves, by the markers `real_time` and `alone` and by `tests.selected.every`; those that do
not are listed here.
"""

from pathlib import Path

REAL_TIME = (
    "adhesion/test_adhesion_command.py",
    "adhesion/test_daemon_of_an_emulated_fan.py",
    "adhesion/test_daemon_process.py",
    "adhesion_dronecan/test_dronecan_node_at_the_wire.py",
    "emulate/",
    "live/test_live_command.py",
    "bench/test_doctor_discover_setup.py::test_discover_without_an_answer",
    "bench/test_doctor_slow_adapter.py::test_an_adapter_as_delivered_is_recognised_at_the_wire",
    "monitor/test_monitor_listens.py",
    "monitor/test_monitor_sink.py::test_real_time_shows_the_same_through_its_own_process",
)
"""Tests that talk in real time and mostly wait, by how their names begin; so do all with `wire` among their
parameters, and those that talk to an `emulator`. They are patient: their like may run beside them."""
WIRED = (
    "bench/test_doctor_discover_setup.py",
    "bench/test_emulator_process.py",
    "contract/",
    "docs/test_shown_commands.py",
    "peers/",
)
"""Where else tests talk to the `wire` or to an `emulator`: no other file is looked through for them."""
ALONE = (
    "adhesion/test_asking_commands.py",
    "adhesion/test_daemon_killed.py",
    "adhesion/test_stopped_for_a_while.py",
    "bench/test_bench_assembly.py::test_a_mix_of_real_and_emulated_devices",
    "bench/test_bench_assembly.py::test_the_same_drive_at_the_wire_in_real_time",
    "bench/test_doctor_discover_setup.py::test_discover_finds_everything",
    "bench/test_doctor_discover_setup.py::test_the_emulated_bench_is_healthy",
    "bench/test_held_in_a_mix.py::test_an_emulated_camera_stops_the_drive_of_real_servos",
    "bench/test_held_in_a_mix.py::test_real_servos_beside_emulated_sensors",
    "bench/test_replug_drivers.py",
    "devices/test_packages_that_hang.py::test_many_short_reads",
    "devices/test_runs_that_hang_are_ended.py",
    "emulate/test_emulate_command.py",
    "emulate/test_emulate_ports.py::test_a_client_that_knows_only_the_standard_connects",
    "live/test_live_command.py::test_a_real_time_recording_repeats_bit_for_bit",
    "live/test_live_command.py::test_nothing_stands_still_while_the_loop_begins",
    "live/test_live_command.py::test_the_summary_says_what_happened",
    "live/test_live_emulated_start.py",
    "live/test_live_remote.py",
    "plugin/test_reruns_and_signals.py::test_a_session_that_is_ended_from_outside",
)
"""Tests that judge how punctual this computer is, need a port of the host that others may want, or see
whether one that they gave back is free."""


_TESTS = Path(__file__).resolve().parent


def files(marker, *places):
    """The files that have tests with a marker, and those of `places`: no other is looked through for them."""
    marked = {
        f"tests/{path.relative_to(_TESTS).as_posix()}"
        for path in _TESTS.rglob("test_*.py")
        if f"mark.{marker}" in path.read_text(encoding="utf-8")
    }
    return tuple(sorted(marked | {"tests/" + place.partition("::")[0] for place in places}))


THINNED = {
    "adhesion_bench/test_hanging_on_the_wall.py::test_who_lies": 6,
    "bench/test_doctor_discover_setup.py::test_a_sick_device": 2,
    "bench/test_held.py::test_whenever_it_happens": 4,
    "bench/test_held.py::test_lost_servos": 6,
    "adhesion_bench/test_hanging_on_the_wall.py::test_no_torque_and_no_motion": 6,
    "bench/test_doctor_discover_setup.py::test_a_device_that_falls_ill": 2,
    "bench/test_doctor_discover_setup.py::test_the_emulated_bench_is_healthy": 2,
    "live/test_live_command.py::test_a_disk_that_fills_up": 2,
    "live/test_live_command.py::test_a_second_signal": 2,
    "live/test_live_command.py::test_a_signal_holds_the_robot": 2,
    "procedure/test_procedures_page.py::test_the_printed_procedure_passes": 2,
    "procedures/test_every_procedure_stops.py::test_a_procedure_struck_while_it_moves": 5,
    "procedures/test_odometry_calibration_run.py::test_it_fails_under_a_fault": 3,
    "procedures/test_surface_identification.py::test_it_fails_under_a_fault": 2,
}
"""Tests with many like cases, by how their names begin: every so many-th of them by default, all of them in
the long run."""
