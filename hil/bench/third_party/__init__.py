"""The boundary to drivers and emulated devices of other packages: checks results, names them in errors."""
