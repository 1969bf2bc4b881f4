"""A CAN bus in memory that can be made to fail."""


class Bus:
    """Works while `error` is None."""

    def __init__(self):
        self.error, self.sent, self.arriving = None, [], []

    def send(self, message):
        if self.error is not None:
            raise self.error
        self.sent.append((message.arbitration_id, bytes(message.data), message.is_extended_id))

    def recv(self, timeout):
        assert timeout == 0
        return self.arriving.pop(0) if self.arriving else None

    def shutdown(self):
        self.error = OSError("used after shutdown")
