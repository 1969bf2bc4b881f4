"""The boundary to drivers and emulated devices of other packages: checked, and errors name the package."""
