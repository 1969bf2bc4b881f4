"""A fan on a motor controller that speaks DroneCAN (UAVCAN v0)."""
