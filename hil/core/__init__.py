"""Parts for all other packages: samples, clocks, geometry, errors, interfaces, the registry of devices."""
