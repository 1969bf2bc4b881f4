"""Propellers on a Teensy that converts lines to pulses."""
