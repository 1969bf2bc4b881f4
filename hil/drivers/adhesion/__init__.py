"""Drivers of the ducted fan that presses the robot on the wall."""
