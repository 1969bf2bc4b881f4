"""Faults: their vocabulary, the plan of a run, and the one rule of what becomes of a message on a wire."""
