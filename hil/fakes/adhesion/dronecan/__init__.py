"""The emulated fan on a controller that speaks DroneCAN."""
