"""A CAN bus in memory that can be made to fail."""


class Bus:
    """Works while `error` is None. While `deaf` is set, that is raised by `recv`, and `send` does nothing."""

    def __init__(self):
        self.error, self.deaf, self.sent, self.arriving = None, None, [], []

    def send(self, message):
        if self.error is not None:
            raise self.error
        if self.deaf is None:
            self.sent.append((message.arbitration_id, bytes(message.data), message.is_extended_id))

    def recv(self, timeout):
        assert timeout == 0
        if self.deaf is not None:
            raise self.deaf
        message = self.arriving.pop(0) if self.arriving else None
        if isinstance(message, Exception):
            raise message
        return message

    def shutdown(self):
        self.error = OSError("used after shutdown")
