"""The registry's shipped half: one package per kind of device, in it one entry per model.

A kind's package says what the bench knows of the kind (`KIND`) and lists its models. A model's entry says how
it is configured, driven, emulated, found and examined. The drivers and emulated chips of the
robot of arXiv 2509.04016 lie in `hil.drivers` and `hil.fakes`; a model that came later has them in its own
folder here, as an installed package has them in its own.

What such a package imports: `hil.core` (kinds, samples, seams, errors), `hil.config.device`,
`hil.devices.emulated_device` (how an emulated device is connected), `hil.devices.doctor_watch` (what the
doctor asks),
`hil.links.serial_url` and `hil.fakes.serial_chip` (bytes on a serial line, from either end).
"""
