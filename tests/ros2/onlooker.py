"""A program that looks at what others offer on DDS, by Cyclone DDS alone.

`onlooker.py DOMAIN SECONDS XML TOPIC` prints what it has seen of others after SECONDS, or as soon as TOPIC is
written: {"written": [topics], "read": [topics]}. XML is the configuration of Cyclone DDS.
"""

import json
import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.domain import Domain, DomainParticipant


def main():
    number, seconds, configuration, wanted = sys.argv[1:]
    domain = Domain(int(number), configuration)
    participant = DomainParticipant(int(number))
    readers = {
        "written": BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
        "read": BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
    }
    seen = {name: set() for name in readers}
    until = time.monotonic() + float(seconds)
    while time.monotonic() < until and not (wanted in seen["written"] and seen["read"]):
        for name, reader in readers.items():
            seen[name] |= {s.topic_name for s in reader.take(N=1000) if s.topic_name.startswith("rt/")}
        time.sleep(0.05)
    print(json.dumps({name: sorted(topics) for name, topics in seen.items()}))
    del domain


if __name__ == "__main__":
    main()
