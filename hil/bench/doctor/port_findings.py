"""Findings on the ports of a bench: other programs that use them, USB supply, unstable names; udev rules.

The USB tree is read from `/sys` of Linux: which device is behind a port, on which hub, with what supply. The
udev rules set latency timer and access rights, and protect the adapters from suspend and other programs.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hil.config.bench import BenchConfig
from hil.config.tracker import T265Config
from hil.core.finding import Finding
from hil.links.serial_url import BY_ID
from hil.support.port_users import PROC, named, programs_with, running

_SELF_POWERED = 0x40
_HUB_CLASS = "09"
HUB_BUDGET_MA = 500
T265_IDS = {("8087", "0b37")}
_USB3_MBIT = 5000.0
_GRABBERS = {
    "ModemManager": (
        "asks every new serial port for seconds whether it is a modem",
        "sudo systemctl disable --now ModemManager; or, where it is needed, the rules of `hil doctor --fix`",
    ),
    "brltty": (
        "takes adapters with CP210x, CH340 and FTDI chips for Braille displays: the port vanishes",
        "sudo apt remove brltty",
    ),
}
_HEAD = """\
# udev rules for the bench {name}, by hil doctor --fix.
# To install: hil doctor --bench FILE --fix | sudo tee {path}
#             sudo udevadm control --reload
#             sudo udevadm trigger
"""
_PATH = "/etc/udev/rules.d/60-hil.rules"
_TIMER = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


@dataclass(frozen=True)
class UsbDevice:
    """A USB device.

    Attributes:
        folder: its folder in sysfs.
        vendor, product: ids, four hexadecimal digits each.
        serial: its serial number; empty where it has none.
        name: product name that the device reports.
        speed_mbit: link speed, Mbit/s; 0 if unknown.
    """

    folder: Path
    vendor: str
    product: str
    serial: str
    name: str
    speed_mbit: float

    @property
    def place(self) -> str:
        """Bus and ports, for example `1-2.3`."""
        return self.folder.name

    @property
    def may_sleep(self) -> bool:
        """Whether the kernel may suspend the device."""
        return text_of(self.folder / "power/control") == "auto"

    def starved_by(self) -> tuple[str, int] | None:
        """The bus-powered hub of the device, and the current of its devices (mA), if too high; else None."""
        hub = self.folder.parent
        powered = _number(text_of(hub / "bmAttributes"), 16)
        is_root = hub.name.startswith("usb")
        if is_root or text_of(hub / "bDeviceClass") != _HUB_CLASS or powered & _SELF_POWERED:
            return None
        asked = sum(_asks_ma(one) for one in hub.iterdir() if (one / "idVendor").is_file())
        return (hub.name, asked) if asked > HUB_BUDGET_MA else None


def behind(port: str, sysfs: Path) -> UsbDevice | None:
    """The USB device behind a serial port; None for other ports.

    Args:
        port: device path, or a link to one.
        sysfs: folder in which the kernel describes its devices.
    """
    if "://" in port:
        return None
    folder = (sysfs / "class/tty" / os.path.basename(os.path.realpath(port)) / "device").resolve()
    for one in (folder, *folder.parents):
        if (one / "idVendor").is_file():
            return read(one)
    return None


def plugged_in(ids: set[tuple[str, str]], sysfs: Path) -> list[UsbDevice]:
    """Devices with these ids (vendor, product)."""
    found = [read(one.resolve()) for one in sorted((sysfs / "bus/usb/devices").glob("*"))]
    return [device for device in found if (device.vendor, device.product) in ids]


def read(folder: Path) -> UsbDevice:
    """Read the sysfs entry of one USB device."""
    vendor, product, serial, name, speed = (
        text_of(folder / key) for key in ("idVendor", "idProduct", "serial", "product", "speed")
    )
    return UsbDevice(folder, vendor, product, serial, name, float(_number(speed, 10)))


def text_of(path: Path) -> str:
    """Text of a sysfs file; empty if it cannot be read."""
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _asks_ma(folder: Path) -> int:
    return _number(text_of(folder / "bMaxPower").removesuffix("mA"), 10)


def _number(text: str, base: int) -> int:
    try:
        return int(text.partition(".")[0], base)
    except ValueError:
        return 0


_CAMERA = tuple(
    f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor}", ATTR{{idProduct}}=="{product}", MODE="0666"'
    for vendor, product in (("03e7", "2150"), *T265_IDS)
)


@dataclass(frozen=True)
class Host:
    """Folders in which the kernel describes this computer.

    Attributes:
        sysfs, proc: mount points of sysfs and procfs.
        by_id: links to serial ports by their adapters' serial numbers.
    """

    sysfs: Path = Path("/sys")
    proc: Path = PROC
    by_id: Path = BY_ID


def real_ports(config: BenchConfig) -> Mapping[str, str]:
    """Local serial ports of real devices, by device; without pseudo-terminals."""
    ports = {}
    for name, device in config.devices().items():
        port = getattr(device, "port", None)
        if not isinstance(port, str) or not port.startswith("/") or device.backend == "emulated":
            continue
        if not os.path.realpath(port).startswith("/dev/pts/"):
            ports[name] = port
    return ports


def host_findings(config: BenchConfig, host: Host) -> Iterator[Finding]:
    """Findings about the computer that concern this bench.

    Args:
        config: the bench configuration.
        host: folders in which the kernel describes this machine.
    """
    ports = real_ports(config)
    if ports:
        programs = {program.name for program in running(host.proc)}
        for name in sorted(programs & set(_GRABBERS)):
            does, remedy = _GRABBERS[name]
            yield Finding("bench", "other programs", "warning", f"{name} runs and {does}", "", remedy)
    seen: set[str] = set()
    for name, port in ports.items():
        yield from _names(name, port, host)
        yield from _sharers(name, port, host)
        adapter = behind(port, host.sysfs)
        if adapter is not None and adapter.place not in seen:
            seen.add(adapter.place)
            yield from _supply(name, adapter)
    camera = config.of(T265Config)
    if camera is not None and camera.backend != "emulated":
        for found in plugged_in(T265_IDS, host.sysfs):
            yield from _camera(found)


def _names(name: str, port: str, host: Host) -> Iterator[Finding]:
    """Finding on an unstable port name: `ttyUSB0` may be another adapter after replugging."""
    device = Path(port).resolve()
    links = sorted(host.by_id.glob("*")) if host.by_id.is_dir() else []
    stable = next((link for link in links if link.resolve() == device), None)
    if stable is not None and not Path(port).is_symlink():
        yield Finding(
            name,
            "port name",
            "warning",
            f"{port} is the adapter that was plugged in at that time",
            "a name that stays",
            f'port = "{stable}"',
        )


def _sharers(name: str, port: str, host: Host) -> Iterator[Finding]:
    """Findings on other programs with the port open without a lock: each would read half of the replies."""
    others = programs_with(port, host.proc)
    if others:
        yield Finding(
            name,
            "other programs",
            "failure",
            f"{port} is open in {named(others)}",
            "no other program",
            f"close it, or kill {others[0].pid}",
        )


def _supply(name: str, adapter: UsbDevice) -> Iterator[Finding]:
    starved = adapter.starved_by()
    if starved is not None:
        hub, asked_ma = starved
        found = f"the devices of hub {hub}, which has no supply, ask for {asked_ma} mA"
        yield Finding(
            name,
            "USB supply",
            "warning",
            found,
            f"at most {HUB_BUDGET_MA} mA",
            "give the hub a supply of its own, or use a port of the computer",
        )
    if adapter.may_sleep:
        found = f"the kernel may suspend {adapter.name or adapter.place}"
        yield Finding(
            name,
            "USB suspend",
            "warning",
            found,
            "never",
            f"echo on | sudo tee {adapter.folder / 'power/control'}",
        )


def _camera(found: UsbDevice) -> Iterator[Finding]:
    slow = 0 < found.speed_mbit < _USB3_MBIT
    yield Finding(
        "tracker",
        "USB speed",
        "warning" if slow else "ok",
        f"{found.speed_mbit:g} Mbit/s",
        f"{_USB3_MBIT:g} Mbit/s",
        "use a blue port and a USB 3 cable of at most 2 m",
    )


def udev_rules(config: BenchConfig, sysfs: Path) -> str:
    """Text of a udev rules file for the connected adapters.

    Args:
        config: the bench configuration; its real devices on local ports count.
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
