"""Emulated devices: models of the chips, the wires they speak on, and the world they live in."""
