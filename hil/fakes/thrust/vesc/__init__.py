"""The emulated propellers on VESC motor controllers."""
