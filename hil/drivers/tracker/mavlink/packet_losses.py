"""Counts the packets that a MAVLink sender has numbered and that never came.

Each packet has a number from 0 to 255. Some senders count for each component, others for each link, so that
packets of another component at the same address may bear the numbers that ours seem to lack. Datagrams may
come in another order than they were sent.
"""

_NUMBERS = 256
_FAR = _NUMBERS // 2
"""A larger step is a restart, not a gap; a packet may come so much later and still fill its gap."""


class PacketLosses:
    """The losses of one component at one address.

    Attributes:
        lost: numbers that no packet of that address had, as far as those after them have come.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._newest: int | None = None
        self._missing: set[int] = set()
        self._of_others: dict[int, int] = {}

    def count(self, number: int) -> None:
        """Take the number of a packet of the component."""
        newest = self._newest
        if newest is None:
            self._newest = number
            return
        step = (number - newest) % _NUMBERS
        if 0 < step < _FAR:
            gap = {newest + k for k in range(1, step)}
            self._missing = {n for n in self._missing if n > newest + step - _FAR}
            self._missing |= {n for n in gap if self._of_others.get(n % _NUMBERS) != n}
            self.lost += len(self._missing & gap)
            self._newest = newest + step
        else:
            self._found(newest + step - _NUMBERS)

    def count_other(self, number: int) -> None:
        """Take the number of a packet of another component at the same address."""
        if self._newest is None:
            return
        step = (number - self._newest) % _NUMBERS
        absolute = self._newest + step - (_NUMBERS if step >= _FAR else 0)
        self._of_others[number] = absolute
        self._found(absolute)

    def _found(self, absolute: int) -> None:
        if absolute in self._missing:
            self._missing.remove(absolute)
            self.lost -= 1
