"""Serial ports by pyserial URL: local devices, and those of `serial_over_tcp`.

A local port reads without checking first whether bytes have come. It belongs to one program at a time: the
first that opens it locks it.
"""

import contextlib
import errno
import fcntl
import grp
import os
import stat
from pathlib import Path
from typing import Any, ClassVar

import serial

from hil.core.errors import DeviceError
from hil.links.injection import FaultyPort, with_faults
from hil.links.serial_over_tcp import RFC2217, SOCKET, open_network_port
from hil.support.port_users import named, programs_with

BY_ID = Path("/dev/serial/by-id")
"""Links to serial ports by their adapters' serial numbers."""
_GROUP_BITS = stat.S_IRGRP | stat.S_IWGRP
_NO_DEVICE = (errno.ENOENT, errno.ENODEV, errno.ENXIO)


def _port_errors() -> tuple[type[Exception], ...]:
    errors: tuple[type[Exception], ...] = (OSError, TypeError, ValueError, AttributeError)
    try:
        import termios
    except ImportError:
        return errors
    return (*errors, termios.error)


PORT_ERRORS = _port_errors()
"""Exceptions of pyserial when a port fails under it; `SerialException` is an `OSError`."""


def close_quietly(port: Any) -> None:
    """Close a port, if there is one; never raises."""
    if port is not None:
        with contextlib.suppress(*PORT_ERRORS):
            port.close()


_Local: Any = serial.Serial


class LocalPort(_Local):  # type: ignore[misc]
    """A local port with one system call for a reply that is all here, and for a request that fits at once.

    In all other cases pyserial waits, and raises the errors.
    """

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; waits for what is missing as long as the timeout allows."""
        data = b""
        if self.is_open:
            with contextlib.suppress(OSError):
                data = os.read(self.fd, size)
        if data and len(data) == size:
            return data
        rest: bytes = super().read(size - len(data))
        return data + rest

    def write(self, data: bytes) -> int:
        """Send all of `data`."""
        sent = 0
        if self.is_open:
            with contextlib.suppress(OSError):
                sent = os.write(self.fd, data)
        if sent == len(data):
            return sent
        rest: int = super().write(data[sent:])
        return sent + rest


class SharedPort(LocalPort):
    """A local port that several drivers of this program have open, and no other program.

    A lock belongs to one descriptor, so that the drivers could not each hold one: they use one together.
    """

    _locks: ClassVar[dict[str, list[int]]] = {}
    """Descriptor that holds the lock and number of drivers that rely on it, by device path."""
    _locked = ""

    def open(self) -> None:
        """Lock the port, before any of its settings is changed, and open it.

        Raises:
            OSError: another program has locked it, or there is no such port.
        """
        path = os.path.realpath(self.port)
        lock = self._locks.get(path)
        if lock is None:
            lock = self._locks[path] = [_locked(path), 0]
        lock[1] += 1
        self._locked = path
        try:
            super().open()
        except BaseException:
            self._unlock()
            raise

    def close(self) -> None:
        """Close it; the last driver unlocks it. Idempotent."""
        super().close()
        self._unlock()

    def _unlock(self) -> None:
        path, self._locked = self._locked, ""
        if not path:
            return
        lock = self._locks[path]
        lock[1] -= 1
        if not lock[1]:
            os.close(self._locks.pop(path)[0])


def _locked(path: str) -> int:
    """A descriptor that keeps other programs out of a port; raises `OSError`."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def latency_timer(port: str, sysfs: Path = Path("/sys")) -> Path | None:
    """The file in which Linux keeps the latency timer (ms) of a USB adapter; None for other ports.

    Args:
        port: device path, or a link to one such as `/dev/serial/by-id/...`.
        sysfs: folder in which the kernel describes its devices.
    """
    if "://" in port:
        return None
    timer = sysfs / "bus/usb-serial/devices" / os.path.basename(os.path.realpath(port)) / "latency_timer"
    return timer if timer.is_file() else None


def cannot_open(device: str, url: str, error: Exception, *, expected: str) -> DeviceError:
    """Convert an exception of `open_serial` to a `DeviceError` with a remedy.

    Args:
        device: name in the error.
        url: URL that could not be opened.
        error: one of `PORT_ERRORS`.
        expected: expected device.
    """
    number = getattr(error, "errno", None)
    remedy = "check the cable and the port name; `hil discover` lists ports"
    if number == errno.EACCES:
        remedy = _permission(url)
    elif number in _NO_DEVICE and "://" not in url:
        remedy = _elsewhere(url, BY_ID)
    elif number in (errno.EBUSY, errno.EAGAIN):
        others = named(programs_with(url)) or f"sudo fuser -v {url} names it"
        remedy = f"close the other program that uses the port: {others}"
    detail = os.strerror(number) if number else str(error)
    return DeviceError(
        device, f"port cannot be opened ({detail})", port=url, expected=expected, remedy=remedy
    )


def _elsewhere(port: str, by_id: Path) -> str:
    """Remedy text for a missing port: a hub that was reset gives its adapters other names."""
    if Path(port).parent == by_id:
        return f"plug in the adapter with this serial number, or name another one; {_present(by_id)}"
    return f"check cable and hub; {_present(by_id)}: name the port by its link, which does not change"


def _present(by_id: Path) -> str:
    """The adapters that are plugged in, by their links."""
    links = sorted(by_id.glob("*")) if by_id.is_dir() else []
    message = ", ".join(f"{link} ({link.resolve().name})" for link in links)
    return (
        f"plugged in now: {message}" if message else f"`hil discover` lists ports, {by_id} shows no adapter"
    )


def _permission(port: str) -> str:
    """Remedy text for a port without permission: its group, or a udev rule where that would not help."""
    group, mode = "dialout", _GROUP_BITS
    with contextlib.suppress(OSError, KeyError):
        found = os.stat(port)
        group, mode = grp.getgrgid(found.st_gid).gr_name, stat.S_IMODE(found.st_mode)
    if group != "root" and mode & _GROUP_BITS == _GROUP_BITS:
        return f"sudo usermod -aG {group} $USER, then log in again"
    return (
        f"it is of group {group} with mode {mode:04o}, so that to join that group is no help: have a udev "
        "rule give it to group dialout; `hil doctor --bench FILE --fix` prints the rules, docs/computer.md, "
        '"Ports", says where they go; then sudo usermod -aG dialout $USER, and log in again'
    )


def open_serial(
    url: str, *, baud: int, timeout_s: float, write_timeout_s: float, shared: bool = False
) -> Any:
    """Open a port, with the faults that are injected in front of its device.

    Args:
        url: device path or any pyserial URL.
        baud: bits per second; a raw socket's server must be set to it.
        timeout_s: timeout of reads.
        write_timeout_s: timeout of writes, where the port has one.
        shared: True if another driver of this program may have the port open, too: one that only writes, one
            that only reads.

    Raises:
        serial.SerialException, OSError, ValueError: as pyserial raises them.
    """
    settings: dict[str, Any] = {"baudrate": baud, "timeout": timeout_s, "write_timeout": write_timeout_s}
    if url.lower().startswith((RFC2217, SOCKET)):
        port = open_network_port(url, baud=baud, timeout_s=timeout_s, write_timeout_s=write_timeout_s)
    elif "://" in url:
        port = serial.serial_for_url(url, **settings)
    else:
        port = SharedPort(url, **settings) if shared else LocalPort(url, exclusive=True, **settings)
    return with_faults(port, FaultyPort)
