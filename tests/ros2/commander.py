"""A program that commands a velocity on ROS 2 by Cyclone DDS alone.

`commander.py DOMAIN TOPIC TYPE RATE_HZ FIELD=VALUE...` writes Twist, TwistStamped or Header at a rate, once
somebody reads (it prints `begun`, then `matched`), until its input ends; FIELD is for example `linear.x`.
At the rate 0 it is there and writes nothing. `lease=2` is how long it counts once it is killed, in seconds.
"""

import select
import sys
import time

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from dds_types import LOOPBACK, RELIABLE, REPRESENTATION, Header, Time, Twist, TwistStamped, Vector3


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
    quality = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10), REPRESENTATION)
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
