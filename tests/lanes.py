"""Which tests run in real time, which alone, and of which like cases some are enough by default."""

REAL_TIME = (
    "adhesion/test_adhesion_command.py",
    "adhesion/test_keeper_of_an_emulated_fan.py",
    "adhesion/test_keeper_process.py",
    "adhesion_dronecan/test_dronecan_node_at_the_wire.py",
    "cli/test_closed_output.py::test_a_command_with_the_robot_in_hand",
    "cli/test_unforeseen.py::test_a_closed_standard_input",
    "devices/test_guide.py",
    "emulate/",
    "live/test_live_command.py",
    "bench/test_doctor_discover_setup.py::test_discover_without_an_answer",
    "bench/test_doctor_slow_adapter.py::test_an_adapter_as_delivered_is_recognised_at_the_wire",
    "mocap/test_mocap_udp.py",
    "monitor/test_monitor_listens.py",
    "monitor/test_monitor_sink.py::test_real_time_shows_the_same_through_its_own_process",
    "tracker/test_tracker_across_processes.py",
)
"""Tests that talk in real time and mostly wait, by how their names begin; so do all with `wire` among their
parameters, and those that talk to an `emulator`. They are patient: their like may run beside them."""
WIRED = (
    "bench/test_doctor_discover_setup.py",
    "bench/test_emulator_process.py",
    "contract/",
    "core/test_how_tests_are_run.py",
    "docs/test_shell_blocks.py",
    "docs/test_shown_commands.py",
    "peers/",
    "tracker_mavlink/test_mavlink_on_the_bench.py",
)
"""Where else tests talk to the `wire` or to an `emulator`: no other file is looked through for them."""
ALONE = (
    "adhesion/test_asking_commands.py",
    "adhesion/test_keeper_killed.py",
    "adhesion/test_stopped_for_a_while.py",
    "bench/test_bench_assembly.py::test_a_mix_of_real_and_emulated_devices",
    "bench/test_bench_assembly.py::test_the_same_drive_at_the_wire_in_real_time",
    "bench/test_doctor_discover_setup.py::test_discover_finds_everything",
    "bench/test_doctor_discover_setup.py::test_the_emulated_bench_is_healthy",
    "bench/test_held_in_a_mix.py::test_an_emulated_camera_stops_the_drive_of_real_servos",
    "bench/test_held_in_a_mix.py::test_an_emulated_fan_does_not_press_a_real_robot",
    "bench/test_held_in_a_mix.py::test_real_servos_beside_emulated_sensors",
    "bench/test_replug_drivers.py",
    "core/test_loop_and_server.py::test_the_server_answers_and_ticks_on_world_time",
    "docs/test_hardware_page.py::test_the_page_can_be_walked",
    "emulate/test_emulate_clients.py::test_a_robot_in_another_physics",
    "emulate/test_emulate_command.py",
    "emulate/test_emulate_ports.py::test_a_client_that_knows_only_the_standard_connects",
    "encoders/test_can_face.py",
    "imu/test_imu_on_a_pty.py",
    "imu_microstrain/test_microstrain_on_a_pty.py",
    "imu_microstrain/test_microstrain_on_a_bench.py::test_up_a_wall_with_it_at_the_wire_in_real_time",
    "live/test_live_command.py::test_a_real_time_recording_repeats_bit_for_bit",
    "live/test_live_command.py::test_nothing_stands_still_while_the_loop_begins",
    "live/test_live_command.py::test_the_summary_says_what_happened",
    "live/test_live_emulated_start.py",
    "live/test_live_remote.py",
    "mocap/test_mocap_flood.py",
    "plugin/test_how_a_test_ends.py::test_at_the_wire",
    "servos/test_servo_on_a_pty.py",
    "tracker_mavlink/test_mavlink_links.py",
    "tracker_mavlink/test_mavlink_on_the_bench.py::test_discovery_finds_a_sender",
    "tracker_mavlink/test_mavlink_on_the_bench.py::test_the_same_drive_at_the_wire_in_real_time",
)
"""Tests that judge how punctual this computer is, need a port of the host that others may want, or see
whether one that they gave back is free."""


def files(*places):
    """The files that tests are in, by how their names begin."""
    return tuple(sorted({"tests/" + place.partition("::")[0] for place in places}))


THINNED = {
    "adhesion_bench/test_hanging_on_the_wall.py::test_falling_adhesion_stops": 3,
    "adhesion_bench/test_hanging_on_the_wall.py::test_who_lies": 6,
    "bench/test_doctor_discover_setup.py::test_a_sick_device": 2,
    "bench/test_held.py::test_whenever_it_happens": 4,
    "bench/test_held.py::test_whoever_loses_servos": 6,
    "calibration/test_calibration_commands.py::test_the_papers_setting": 3,
    "calibration/test_fit.py::test_all_four_methods_meet": 2,
    "calibration/test_fit.py::test_all_methods_keep_to_one_box": 2,
    "calibration/test_driven_demo_data.py::test_a_bench_drives": 2,
    "cli/test_cli_walk.py::test_a_wrong_value": 6,
    "cli/test_closed_output.py::test_a_command_that_only_reports": 6,
    "controller/test_sensors_judge_each_other.py::test_on_the_floor_who_lies": 2,
    "controller/test_sensors_judge_each_other.py::test_servos_that_fall_silent_in_motion": 2,
    "controller/test_sensors_judge_each_other.py::test_what_the_estimator_copes_with": 2,
    "controller/test_tracking.py::test_tracks_without_slip": 3,
    "estimator/test_estimator_engines.py::test_compiled_engine_equals_filterpy": 5,
    "estimator/test_estimator_hybrid.py::test_disturbances_grow": 12,
    "adhesion_bench/test_hanging_on_the_wall.py::test_no_torque_and_no_motion": 6,
    "estimator/test_camera_scale.py::test_the_scale_of_the_wheels": 2,
    "estimator/test_camera_scale.py::test_a_camera_whose_noise_is_known": 2,
    "estimator/test_estimator_beside_wpimath.py::test_accuracy_is_better": 2,
    "estimator/test_estimator_consistency.py::test_nees_and_nis": 2,
    "plant/test_mujoco_contact.py::test_a_circle_of_three_metres": 2,
    "bench/test_doctor_discover_setup.py::test_a_device_that_falls_ill": 2,
    "bench/test_doctor_discover_setup.py::test_the_emulated_bench_is_healthy": 2,
    "live/test_live_command.py::test_a_disk_that_fills_up": 2,
    "live/test_live_command.py::test_a_second_signal": 2,
    "live/test_live_command.py::test_a_signal_holds_the_robot": 2,
    "procedure/test_procedures_page.py::test_the_printed_procedure_passes": 2,
    "procedures/test_every_procedure_stops.py::test_a_procedure_struck_while_it_moves": 5,
    "procedures/test_odometry_calibration_run.py::test_it_fails_under_a_fault": 3,
    "procedures/test_surface_identification.py::test_it_fails_under_a_fault": 2,
    "recording/test_mcap_file.py::test_a_killed_process": 2,
    "servos/test_servo_driver_faults.py::test_a_bad_line": 3,
    "servos/test_servo_driver_faults.py::test_a_dead_servo_costs_little": 5,
}
"""Tests with many like cases, by how their names begin: every so many-th of them by default, all of them in
the long run."""
