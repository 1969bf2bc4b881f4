"""The built-in entries of the device registry: one package per kind of device, one entry per model.

A kind's package defines the kind (`KIND`) and lists its models. A model's entry defines its configuration,
driver, emulation, discovery and doctor checks. The drivers and emulated chips of the robot of
arXiv 2509.04016 are in `hil.drivers` and `hil.fakes`; a model that was added later has both in its own folder
here, as a model of an installed package has them in that package.

Such a package imports: `hil.core` (kinds, samples, interfaces, errors), `hil.config.device`,
`hil.devices.emulated_device` (how an emulated device is connected), `hil.devices.doctor_watch` (doctor
checks), `hil.links.serial_url` and `hil.fakes.serial_chip` (bytes on a serial line, from either end).
"""
