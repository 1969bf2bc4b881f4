"""What the machine around a bench does to it: USB adapters, hubs, other programs; and rules against that."""

from hil.bench.host.findings import Host, host_findings
from hil.bench.host.rules import udev_rules

__all__ = ["Host", "host_findings", "udev_rules"]
