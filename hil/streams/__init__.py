"""Streams of samples: clocks and stamps, silence, stuck values, jumps; bases of sensors that stream."""
