"""A program that drives a robot on ROS 2 by Cyclone DDS alone.

`driver.py DOMAIN TOPIC SETTINGS` prints `begun`, writes commands until its input ends, then prints how many.
SETTINGS is a JSON object:
- `on`: `joint_states` or `clock`: answers each message; a number: writes at that rate in Hz;
- `stamp`: `copy` of the joint states, `clock`, `wall` or `none`;
- `type`: `JointState` (default), `Twist` or `TwistStamped`;
- `name`, `position`, `velocity`, `effort`; of a twist `velocity` are the six numbers;
- `follow`: rolls by the distance of `/odom` from `/reference` along x, times this, in rad/s per m; waits
  until these and joint states have come since the last answer (joint states that were read ahead are up to a
  period older than the other two);
- `best_effort`: offers no reliability;
- `limit`: ends by itself, killed, after so many commands;
- `then`: settings that hold instead after `after` commands.
"""

import json
import os
import select
import signal
import sys
import time

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from dds_types import (
    LOOPBACK,
    RELIABLE,
    REPRESENTATION,
    Clock,
    Header,
    JointState,
    Odometry,
    PoseStamped,
    Time,
    Twist,
    TwistStamped,
    Vector3,
)

NAMES = [f"{what}_{wheel}" for what in ("drive", "steer") for wheel in ("FL", "BL", "BR", "FR")]
TYPES = {"JointState": JointState, "Twist": Twist, "TwistStamped": TwistStamped}


def quality(reliable, depth):
    return Qos(
        RELIABLE if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        REPRESENTATION,
    )


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


class Driver:
    def __init__(self, domain, topic, settings):
        self.settings, self.sent = settings, 0
        self.participant = DomainParticipant(domain)
        kind = TYPES[settings.get("type", "JointState")]
        reliable = not settings.get("best_effort")
        self.writer = DataWriter(
            self.participant, Topic(self.participant, f"rt{topic}", kind), quality(reliable, 1)
        )
        self.states = self.reader("/joint_states", JointState, True)
        self.clock = self.reader("/clock", Clock, False)
        self.odom = self.reader("/odom", Odometry, True)
        self.reference = self.reader("/reference", PoseStamped, True)
        self.latest, self.new = {}, set()

    def reader(self, name, kind, reliable):
        topic = Topic(self.participant, f"rt{name}", kind)
        return DataReader(self.participant, topic, quality(reliable, 10))

    def look(self):
        """Whether what is waited for has come."""
        for name in ("reference", "odom", "clock", "states"):  # against the order of sending
            for sample in getattr(self, name).take(N=10):
                if sample.sample_info.valid_data:
                    self.latest[name] = sample
                    self.new.add(name)
        if not self.awaited() <= self.new or not self.is_whole():
            return False
        self.new.clear()
        return True

    def awaited(self):
        """Names of what must have come since the last answer."""
        followed = {"states", "odom", "reference"} if "follow" in self.settings else set()
        return followed | {name for name in ("states", "clock") if name in str(self.settings["on"])}

    def is_whole(self):
        """Whether estimate and reference, if they are followed, are of one cycle."""
        if "follow" not in self.settings:
            return True
        return nanoseconds(self.latest["odom"]) == nanoseconds(self.latest["reference"])

    def stamp(self):
        how = self.settings.get("stamp", "copy")
        if how == "copy" and "states" in self.latest:
            return self.latest["states"].header.stamp
        if how == "clock" and "clock" in self.latest:
            return self.latest["clock"].clock
        if how == "wall":
            return Time(*divmod(time.time_ns(), 10**9))
        return Time(0, 0)

    def command(self):
        given = self.settings
        velocity = given.get("velocity", [0.0] * 4)
        if "follow" in given and {"odom", "reference"} <= set(self.latest):
            off = self.latest["reference"].pose.position.x - self.latest["odom"].pose.pose.position.x
            velocity = [given["follow"] * off] * 4
        header = Header(self.stamp(), "")
        if given.get("type", "JointState") == "JointState":
            values = (given.get("position", [0.0] * 4), velocity, given.get("effort", []))
            return JointState(header, given.get("name", NAMES), *(list(map(float, v)) for v in values))
        twist = Twist(Vector3(*velocity[:3]), Vector3(*velocity[3:]))
        return twist if given["type"] == "Twist" else TwistStamped(header, twist)

    def write(self):
        self.writer.write(self.command())
        self.sent += 1
        if self.sent == self.settings.get("limit"):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.sent == self.settings.get("after"):
            self.settings |= self.settings["then"]

    def run(self):
        print("begun", flush=True)
        following = time.monotonic()
        while True:
            on = self.settings["on"]
            if isinstance(on, str):
                if self.look():
                    self.write()
                    continue
                wait = 0.0005
            else:
                self.look()
                if time.monotonic() >= following:
                    following += 1.0 / on
                    self.write()
                    continue
                wait = following - time.monotonic()
            if select.select([sys.stdin], [], [], max(0.0, wait))[0]:
                return


def main():
    number, topic, settings = sys.argv[1:]
    domain = Domain(int(number), LOOPBACK)
    driver = Driver(int(number), topic, json.loads(settings))
    driver.run()
    print(driver.sent, flush=True)
    del driver, domain


if __name__ == "__main__":
    main()
