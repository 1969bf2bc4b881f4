"""Keys of a bench file for tests at the wire in which this computer's load must not count as silence.

An emulator that another program keeps from its core for a moment answers late: a chip does not.
"""

PATIENT = {
    "safety.servo_stale_s": 2.0,
    "servos.fail_after_s": 5.0,
    "servos.reply_slack_s": 0.03,
    "imu.reply_timeout_s": 0.1,
    "imu.fail_after_s": 10.0,
}

FANLESS = {"adhesion": None, "thrust": None, "load_cells": None}
"""For tests of something else: nobody waits for a fan; the emulated robot is pressed on its wall anyway."""
