"""Ports, buses, packets, stamps and silence; protocols that several devices share (VESC, DroneCAN)."""
