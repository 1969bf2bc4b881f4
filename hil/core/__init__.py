"""What every other package speaks: samples and states, seams, time, geometry, errors, files."""
