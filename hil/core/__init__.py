"""What every other package uses: samples, clocks, geometry, errors, interfaces, the registry of devices."""
