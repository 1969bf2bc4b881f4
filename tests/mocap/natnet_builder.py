"""NatNet packets built field by field from the published layout, independent of driver and emulator.

Every section can be filled, so that a client has to pass over what it does not want. Numbers are
chosen so that each field is recognisable.
"""

import struct

VERSIONS = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]


def message(identifier, payload):
    return struct.pack("<HH", identifier, len(payload)) + payload


def text(value):
    return value.encode() + b"\0"


def counted(items, version):
    """A section: its count, since 4.1 its size, its items."""
    data = b"".join(items)
    head = struct.pack("<i", len(items))
    return head + (struct.pack("<I", len(data)) if version >= (4, 1) else b"") + data


def body(identifier, position=(1.0, 2.0, 3.0), rotation=(0.0, 0.0, 0.0, 1.0), error=0.0005, flags=1):
    return struct.pack("<i3f4ffh", identifier, *position, *rotation, error, flags)


def points(*values):
    return struct.pack("<i", len(values) // 3) + struct.pack(f"<{len(values)}f", *values)


def channels(identifier, *rows):
    """A force plate or a device: rows of samples."""
    data = b"".join(struct.pack(f"<i{len(row)}f", len(row), *row) for row in rows)
    return struct.pack("<ii", identifier, len(rows)) + data


def labelled_marker(identifier):
    return struct.pack("<i3ffhf", identifier, 0.1, 0.2, 0.3, 0.014, 0x0A, 0.0002)


def asset(identifier, bodies, markers):
    return (
        struct.pack("<ii", identifier, len(bodies))
        + b"".join(bodies)
        + struct.pack("<i", len(markers))
        + b"".join(struct.pack("<i3ffHf", m, 1.0, 2.0, 3.0, 0.01, 2, 0.0) for m in markers)
    )


def frame(version, number, bodies, *, full=True, suffix=(0, 0, 12.5, 1000, 1400, 2000), flags=0):
    """A frame of capture data; `full` puts something into every section."""
    fill = (lambda *items: list(items)) if full else (lambda *items: [])
    sections = [
        fill(text("robot") + points(*range(6)), text("all") + points(*range(9))),
        fill(struct.pack("<3f", 9, 8, 7)),
        bodies,
        fill(struct.pack("<ii", 70, 2) + body(71) + body(72)),
        fill(labelled_marker(0x10001), labelled_marker(0x10002)),
        fill(channels(80, [1.0, 2.0], [3.0], [])),
        fill(channels(90, [4.0])),
    ]
    if version >= (4, 1):
        sections.insert(4, fill(asset(60, [body(61)], [62, 63])))
    data = struct.pack("<i", number) + b"".join(counted(items, version) for items in sections)
    precision = struct.pack("<II", 5, 6) if version >= (4, 2) else b""
    data += struct.pack("<IId3Q", *suffix) + precision + struct.pack("<Hi", flags, 0)
    return message(7, data)


def body_model(version, name, identifier, markers=3):
    data = text(name) + struct.pack("<ii3f", identifier, -1, 0.0, 0.0, 0.0)
    if version >= (4, 2):
        data += struct.pack("<4f", 0, 0, 0, 1)
    data += struct.pack("<i", markers) + struct.pack(f"<{3 * markers}f", *range(3 * markers))
    data += struct.pack(f"<{markers}i", *range(markers))
    if version >= (4, 0):
        data += b"".join(text(f"m{k}") for k in range(markers))
    return data


def models(version, *definitions):
    """Definitions as (kind, data)."""
    data = struct.pack("<i", len(definitions))
    for kind, item in definitions:
        data += struct.pack("<i", kind)
        data += (struct.pack("<I", len(item)) if version >= (4, 1) else b"") + item
    return message(5, data)


def other_models(version):
    """One definition of every kind that is not a rigid body."""
    skeleton = text("human") + struct.pack("<ii", 7, 1) + body_model(version, "hip", 8)
    plate = struct.pack("<i", 11) + text("serial") + struct.pack("<161f", *range(161))
    plate += struct.pack("<iii", 0, 1, 2) + text("fx") + text("fy")
    device = (
        struct.pack("<i", 12) + text("daq") + text("0815") + struct.pack("<iii", 0, 1, 1) + text("trigger")
    )
    camera = text("camera 1") + struct.pack("<7f", *range(7))
    markers = text("robot") + struct.pack("<i", 2) + text("a") + text("b")
    return [(0, markers), (2, skeleton), (3, plate), (4, device), (5, camera)]


def server_info(version=(4, 1), clock_hz=10_000_000, data_port=1511, group=None, *, short=False):
    data = struct.pack("<256s4B4B", b"Motive", 3, 1, 0, 2, *version, 0, 0)
    if not short:
        address = bytes(map(int, (group or "0.0.0.0").split(".")))
        data += struct.pack("<QHB", clock_hz, data_port, group is not None) + address
    return message(1, data)
