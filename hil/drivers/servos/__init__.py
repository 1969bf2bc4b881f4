"""The eight servos: four drives and four steers."""
