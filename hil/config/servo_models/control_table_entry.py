"""One entry of a servo's control table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Register:
    """One entry of the control table.

    Attributes:
        address, size: address and length of the entry, bytes.
        writable: access RW.
        eeprom: True for the area that is kept without power and locked while torque is on.
        signed: two's complement.
        default: raw count after a factory reset.
        low, high: permitted raw counts, None where the register cannot be written or another bounds it.
        values: the only permitted raw counts, empty when a range holds.
        limit: name of the register that bounds the absolute value, or empty.
        unit, scale: SI unit, and SI value of one count (1 and no unit for flags).
        firmware: first firmware that has the register; 0 for every one.
    """

    name: str
    address: int
    size: int
    writable: bool
    eeprom: bool
    signed: bool = False
    default: int = 0
    low: int | None = None
    high: int | None = None
    values: tuple[int, ...] = ()
    limit: str = ""
    unit: str = ""
    scale: float = 1.0
    firmware: int = 0

    @property
    def end(self) -> int:
        """Address of the byte behind it."""
        return self.address + self.size

    def encode(self, raw: int) -> bytes:
        """Little-endian bytes of a raw count."""
        return (raw & ((1 << 8 * self.size) - 1)).to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """Raw count of little-endian bytes."""
        return int.from_bytes(data[: self.size], "little", signed=self.signed)

    def range_text(self) -> str:
        """The permitted raw counts in words."""
        if self.values:
            return "one of " + ", ".join(str(v) for v in self.values)
        return f"{self.low}..{self.high}" if self.low is not None else f"within +-{self.limit}"

    def permits(self, raw: int) -> bool:
        """Whether the table itself allows a raw count (a limit register may allow less)."""
        if self.values:
            return raw in self.values
        return self.low is None or self.high is None or self.low <= raw <= self.high
