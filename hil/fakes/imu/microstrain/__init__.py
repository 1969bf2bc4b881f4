"""The emulated MicroStrain sensor: commands, sensors and filter."""
