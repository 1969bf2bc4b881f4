"""A program that commands a velocity on ROS 2 by Cyclone DDS alone: its types are written by hand.

`commander.py DOMAIN TOPIC TYPE RATE_HZ FIELD=VALUE...` writes Twist, TwistStamped or Header at a rate, once
somebody reads (it prints `begun`, then `matched`), until its input ends; FIELD is for example `linear.x`.
At the rate 0 it is there and writes nothing. `lease=2` is how long it counts once it is killed, in seconds.
"""

import select
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
@final
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
@final
class TwistStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TwistStamped_"):
    header: Header
    twist: Twist


def main():
    number, name, kind, rate_hz, *fields = sys.argv[1:]
    twist = Twist(Vector3(), Vector3())
    lease = ""
    for field in fields:
        place, value = field.split("=")
        if place == "lease":
            lease = f"<Discovery><LeaseDuration>{value}s</LeaseDuration></Discovery>"
            continue
        part, axis = place.split(".")
        setattr(getattr(twist, part), axis, float(value))
    header = Header(Time(1, 2), "base_link")
    message = {"Twist": twist, "TwistStamped": TwistStamped(header, twist), "Header": header}[kind]
    domain = Domain(int(number), LOOPBACK.replace("</Domain>", f"{lease}</Domain>"))
    participant = DomainParticipant(int(number))
    representation = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
    reliability = Policy.Reliability.Reliable(duration(milliseconds=100))
    quality = Qos(reliability, Policy.Durability.Volatile, Policy.History.KeepLast(10), representation)
    writer = DataWriter(participant, Topic(participant, f"rt{name}", type(message)), quality)
    reported = False
    print("begun", flush=True)
    rate_hz = float(rate_hz)
    while not select.select([sys.stdin], [], [], 1.0 / rate_hz if rate_hz else 0.05)[0]:
        if writer.get_matched_subscriptions():
            if not reported:
                reported = True
                print("matched", flush=True)
            if rate_hz:
                writer.write(message)
    time.sleep(0.1)
    del domain


if __name__ == "__main__":
    main()
