"""A packet-level client of single servos by register name, for tests over the wire."""

from hil.config.servo_models import servo_model
from hil.drivers.servos.dynamixel.packets import find_statuses, instruction

PING, READ, WRITE, REG_WRITE, ACTION = 1, 2, 3, 4, 5
FACTORY, REBOOT, CLEAR, BACKUP = 6, 8, 0x10, 0x20
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
ALL = 0xFE

MODEL = servo_model(1010)
TABLE, RAD_PER_COUNT, RAD_S_PER_COUNT = MODEL.table, MODEL.rad_per_count, MODEL.rad_s_per_count


def word(value):
    return value.to_bytes(2, "little")


def where(name, length=None):
    """Address and length of a register as parameters."""
    register = TABLE[name]
    return word(register.address) + word(length or register.size)


class Client:
    """Single instructions to one servo by register name; answers are (error, parameters) or None."""

    def __init__(self, bench, servo_id=1):
        self.bench, self.servo_id = bench, servo_id

    def do(self, code, parameters=b"", wait_ms=3):
        data = self.bench.send(instruction(self.servo_id, code, parameters), wait_ns=int(wait_ms * 1e6))
        found = find_statuses(data)
        return (found[0][1].error, found[0][1].data) if found else None

    def get(self, name):
        register = TABLE[name]
        error, data = self.do(READ, where(name))
        assert error & 0x7F == 0
        return register.decode(data)

    def put(self, name, raw, code=WRITE):
        register = TABLE[name]
        answer = self.do(code, word(register.address) + register.encode(raw))
        return None if answer is None else answer[0]

    def raw(self, address, data):
        return self.do(WRITE, word(address) + bytes(data))[0]

    def wait(self, seconds):
        world = self.bench.world
        world.advance_to(world.now_ns + round(seconds * 1e9))
        world.sync_plant()
