"""A fan whose controller speaks DroneCAN: the few messages that keep it running, and its driver."""
