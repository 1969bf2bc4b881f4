"""udev rules for the adapters of a bench: latency timer, access, no suspend, hands off for other programs."""

from __future__ import annotations

from pathlib import Path

from hil.bench.doctor.host_usb import UsbDevice, behind
from hil.bench.doctor.port_findings import T265_IDS, real_ports
from hil.config.bench import BenchConfig
from hil.config.tracker import T265Config

_HEAD = """\
# udev rules for the bench {name}, by hil doctor --fix.
# To install: hil doctor --bench FILE --fix | sudo tee {path}
#             sudo udevadm control --reload
#             sudo udevadm trigger
"""
_PATH = "/etc/udev/rules.d/60-hil.rules"
_TIMER = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
_CAMERA = tuple(
    f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor}", ATTR{{idProduct}}=="{product}", MODE="0666"'
    for vendor, product in (("03e7", "2150"), *T265_IDS)
)


def udev_rules(config: BenchConfig, sysfs: Path) -> str:
    """Text of a rules file for what is plugged in.

    Args:
        config: of the bench; its real devices on local ports count.
        sysfs: folder in which the kernel describes its devices.
    """
    lines = [
        _HEAD.format(name=config.name, path=_PATH),
        "# FTDI adapters pass on at once what they hold",
        _TIMER,
    ]
    reported: set[str] = set()
    for name, port in real_ports(config).items():
        adapter = behind(port, sysfs)
        if adapter is None:
            lines += ["", f"# {name}: no USB adapter is behind {port}; plug it in for its rules"]
        elif adapter.place not in reported:
            reported.add(adapter.place)
            lines += ["", f"# {name}: {adapter.name or 'adapter'} on {port}", *_adapter(adapter)]
    camera = config.of(T265Config)
    if camera is not None and camera.backend != "emulated":
        lines += ["", "# T265, before and after it was given its firmware", *_CAMERA]
    return "\n".join(lines) + "\n"


def _adapter(adapter: UsbDevice) -> tuple[str, str]:
    ids = f'{{idVendor}}=="{adapter.vendor}", ATTR{{idProduct}}=="{adapter.product}"'
    usb = f'ACTION=="add", SUBSYSTEM=="usb", ATTR{ids}'
    tty = f'SUBSYSTEM=="tty", ATTRS{ids.replace("ATTR{", "ATTRS{")}'
    if adapter.serial and '"' not in adapter.serial:
        usb += f', ATTR{{serial}}=="{adapter.serial}"'
        tty += f', ATTRS{{serial}}=="{adapter.serial}"'
    return (
        f'{usb}, ATTR{{power/control}}="on", ENV{{ID_MM_DEVICE_IGNORE}}="1"',
        f'{tty}, GROUP="dialout", MODE="0660", TAG+="uaccess", ENV{{ID_MM_PORT_IGNORE}}="1"',
    )
