"""The bench's place on DDS: domain, network interface, node; and the configuration of Cyclone DDS.

Every host that reaches the ports can read the bench, and command it if it accepts commands: DDS has no
password. So only this computer can reach the bench unless an interface is named.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from hil.config.ros2 import Ros2Config
from hil.core.errors import ConfigError, UsageError
from hil.core.known_names import HIGHEST_DOMAIN, DistributionName
from hil.support.extras import how_to_install, why_unusable

_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_LOOPBACK = "lo"


@dataclass(frozen=True)
class Network:
    """Place of the bench on DDS.

    Attributes:
        domain: number of the DDS domain, as in `ROS_DOMAIN_ID`.
        interface: network interface beside loopback; empty, or loopback itself, for loopback alone.
        distribution: distribution of ROS 2 for which the bench is announced as a node; None for no
            announcement.
        node: its name there.
    """

    domain: int = 0
    interface: str = ""
    distribution: DistributionName | None = None
    node: str = "hil_bench"

    @property
    def reaches_out(self) -> bool:
        """Whether other computers see the bench."""
        return self.interface not in ("", _LOOPBACK)

    def configuration(self) -> str:
        """XML for Cyclone DDS.

        Discovery every second: a ROS 2 node of default settings announces itself by multicast, which is not
        received on loopback, so it is found by the bench's own announcements. Key hashes: without them Fast
        DDS does not notice that a bench has ended, and lists it for 10 s more.
        """
        names = [self.interface, _LOOPBACK] if self.reaches_out else [_LOOPBACK]
        interfaces = "".join(f"<NetworkInterface name={quoteattr(name)}/>" for name in names)
        return (
            '<CycloneDDS><Domain Id="any"><General>'
            f"<Interfaces>{interfaces}</Interfaces>"
            f"<AllowMulticast>{'true' if self.reaches_out else 'false'}</AllowMulticast>"
            "</General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
            "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
            '<Peers><Peer address="127.0.0.1"/></Peers><SPDPInterval>1s</SPDPInterval>'
            "</Discovery><Internal><GenerateKeyhash>true</GenerateKeyhash></Internal>"
            "</Domain></CycloneDDS>"
        )

    def in_words(self) -> str:
        """Domain and reach."""
        where = f"loopback and {self.interface}" if self.reaches_out else "loopback only"
        return f"domain {self.domain}, {where}"


def network_of(
    config: Ros2Config, environment: Mapping[str, str], *, domain: int | None = None, interface: str = ""
) -> Network:
    """Network of a bench: from the arguments, else from its file, else from the environment.

    Args:
        config: `[ros2]` of the bench file.
        environment: environment variables of the process.
        domain: domain that was asked for; None if none was.
        interface: interface that was asked for; empty if none was.

    Raises:
        UsageError: the environment names no domain.
    """
    given = config.domain if domain is None else domain
    where = domain_of(given, environment), interface or config.interface or ""
    return Network(*where, config.distribution, config.node)


def domain_of(given: int | None, environment: Mapping[str, str]) -> int:
    """The domain that was asked for, else that of `ROS_DOMAIN_ID`, else 0.

    Raises:
        UsageError: it is no domain.
    """
    if given is not None:
        return given
    text = environment.get(_DOMAIN_VARIABLE, "").strip()
    if not text:
        return 0
    if not (text.isascii() and text.isdigit() and int(text) <= HIGHEST_DOMAIN):
        raise UsageError(
            f"{_DOMAIN_VARIABLE} is {text!r}",
            expected=f"a whole number from 0 to {HIGHEST_DOMAIN}",
            remedy="set it right, or give --ros2-domain",
        )
    return int(text)


def must_be_usable() -> None:
    """Raise `ConfigError` where the extra `ros2` cannot be used."""
    why = why_unusable("ros2")
    if why:
        raise ConfigError(f"ROS 2 needs the extra ros2: {why}", remedy=how_to_install("ros2"))
