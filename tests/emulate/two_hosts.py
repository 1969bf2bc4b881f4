"""Two hosts on one cable, as network namespaces of one computer: one emulates a fan, the other commands it.

`unshare -rn python two_hosts.py` is the first host and makes the second one. Prints one JSON object: which
frames python-can's own bus heard here, and how fast the fan ran at the command of whom.
"""

import json
import struct
import subprocess
import sys
import time

import can
from can.interfaces.udp_multicast.utils import pack_message
from emulators import emulator

HERE, THERE = "10.254.7.1", "10.254.7.2"
LISTENS_S = 1.5
UNICAST, MULTICAST, LOCAL = 0.11, 0.12, 0.3
SENDS = """
import socket, sys
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
    out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 4)
    for text in sys.argv[2:]:
        host, data = text.split("=")
        out.sendto(bytes.fromhex(data), (host, int(sys.argv[1])))
"""


def ip(command, *, inside=()):
    subprocess.run([*inside, "ip", *command.split()], check=True)


def wire(there):
    """The cable: `near` on this host, `far` on that one, each with the other as its way to everywhere."""
    inside = ("nsenter", "-t", str(there), "-n")
    ip("link set lo up")
    ip(f"link add near type veth peer name far netns {there}")
    for name, address, other, where in (("near", HERE, THERE, ()), ("far", THERE, HERE, inside)):
        ip(f"addr add {address}/24 dev {name}", inside=where)
        ip(f"link set {name} up", inside=where)
        ip(f"route add default via {other}", inside=where)
    return inside


def set_duty(controller_id, duty):
    """VESC's CAN_PACKET_SET_DUTY."""
    return can.Message(arbitration_id=controller_id, data=struct.pack(">i", round(1e5 * duty)))


def listen(bus, controller_id):
    """(duties that are commanded, highest speed that the fan reports in electrical 1/min) for a while."""
    duties, erpm, end_s = set(), 0, time.monotonic() + LISTENS_S
    while time.monotonic() < end_s:
        message = bus.recv(0.1)
        if message is not None and message.arbitration_id == controller_id:
            duties.add(struct.unpack(">i", message.data)[0] / 1e5)
        elif message is not None and message.arbitration_id == 9 << 8 | controller_id:
            erpm = max(erpm, struct.unpack(">i", message.data[:4])[0])
    return sorted(duties), erpm


def main():
    with subprocess.Popen(["unshare", "-n", "cat"], stdin=subprocess.PIPE) as there:
        time.sleep(0.5)
        inside = wire(there.pid)
        with emulator("--only", "adhesion") as serving:
            where = serving.endpoints()["adhesion"]
            group, port, fan = where["channel"], where["port"], 1
            with can.Bus(interface="udp_multicast", channel=group, port=port, hop_limit=0) as client:
                listen(client, fan)
                orders = ((HERE, UNICAST), (group, MULTICAST))
                frames = [f"{to}={pack_message(set_duty(fan, duty)).hex()}" for to, duty in orders]
                sends = [*inside, sys.executable, "-c", SENDS, str(port)]
                subprocess.run([*sends, *(frames * 10)], check=True)
                foreign, erpm_by_them = listen(client, fan)
                for _ in range(10):
                    client.send(set_duty(fan, LOCAL))
                own, erpm_by_us = listen(client, fan)
        there.stdin.close()
    print(json.dumps({"foreign": foreign, "by_them": erpm_by_them, "own": own, "by_us": erpm_by_us}))


if __name__ == "__main__":
    main()
