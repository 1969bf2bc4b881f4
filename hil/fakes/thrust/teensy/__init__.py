"""The emulated propellers on a Teensy: speed controllers and motors."""
