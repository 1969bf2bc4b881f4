"""A visual-inertial computer that sends its poses by MAVLink."""
