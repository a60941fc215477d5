"""A world with one or more drives, and a master that speaks raw frames to it; single-threaded, in virtual time."""

import math
import struct

import canopen

from drive_profiles.standard.cia301 import DataType, SdoAbortCode, decode, encode
from drive_profiles.standard.cia402 import Object, State, state_of
from hil.can.frame import Frame
from hil.robot_tables import Control
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

AXIS = NODE = 3
COUNTS_PER_REV = 131072
TURN = 2.0 * math.pi
MS = 1_000_000

GAINS = Control(position_gain_per_s=25.0, velocity_gain_nm_s_rad=0.0905, velocity_integral_gain_nm_rad=1.81)
_REFERENCE = load_robot("reference")
ONE_AXIS = Robot(axis={AXIS: _REFERENCE.axis[AXIS].model_copy(update={"control": GAINS})})
"""Axis 3 of the reference robot alone, with the gains of the reference bench."""
NO_GAINS = Robot(axis={AXIS: _REFERENCE.axis[AXIS]})

CONTROL, STATUS = (Object.CONTROL_WORD, 0, 16), (Object.STATUS_WORD, 0, 16)
TARGET, POSITION = (Object.TARGET_POSITION, 0, 32), (Object.POSITION_ACTUAL, 0, 32)
TARGET_TORQUE, TORQUE = (Object.TARGET_TORQUE, 0, 16), (Object.TORQUE_ACTUAL, 0, 16)


def revolutions(turns):
    """Revolutions of the motor as the drive counts them."""
    return round(turns * COUNTS_PER_REV)


class Rig:
    """A world and its master.

    Attributes:
        seen: Every frame that a node has sent.
        now: The world's time, by way of the world.
    """

    def __init__(self, robot=ONE_AXIS, axis=AXIS):
        self.world = World(robot)
        self.drive = self.world.drives[axis]
        self.node = self.drive.node_id
        self.motion = self.world.axes.motion[self.drive.row]
        self.plant = self.world.axes.plant_state[self.drive.row]
        self.notch_state = self.world.axes.notch_state[self.drive.row]
        self.seen = list(self.world.power_on())
        self._types = {(entry.index, entry.subindex): entry.data_type for entry in self.drive.slave.dictionary}

    # -- frames

    def send(self, can_id, data=b""):
        answers = self.world.receive(Frame(can_id, bytes(data)))
        self.seen += answers
        return answers

    def nmt(self, command, node=None):
        return self.send(0x000, (command, self.node if node is None else node))

    def start(self):
        return self.nmt(1)

    def wait(self, milliseconds):
        frames = self.world.finish_period() + self.world.free_step(self.world.now + round(milliseconds * MS))
        self.seen += frames
        return frames

    def sync(self, count=1):
        """SYNCs with the period that each is worth; the frames of the last."""
        frames = []
        for _ in range(count):
            frames = self.send(0x080)
            late = self.world.finish_period()
            self.seen += late
            frames = frames + late
        return frames

    def heartbeat(self, node=127):
        return self.send(0x700 + node, b"\x05")

    def emergencies(self):
        """The error codes that the drive has sent, in their order; 0 is "all is well again"."""
        return [int.from_bytes(f.data[:2], "little") for f in self.seen if f.can_id == 0x080 + self.node]

    # -- objects

    def request(self, *data):
        answers = [f for f in self.send(0x600 + self.node, bytes(data).ljust(8, b"\0")) if f.can_id == 0x580 + self.node]
        assert len(answers) == 1
        return answers[0].data

    def write_raw(self, index, subindex, data):
        """Expedited download; the abort code, or None."""
        answer = self.request(0x23 | (4 - len(data)) << 2, *struct.pack("<HB", index, subindex), *data)
        return SdoAbortCode(int.from_bytes(answer[4:], "little")) if answer[0] == 0x80 else None

    def write(self, index, subindex, value):
        return self.write_raw(index, subindex, encode(self._types[index, subindex], value))

    def set(self, index, subindex, value):
        """Write what must be accepted."""
        assert self.write(index, subindex, value) is None, f"{index:04X}h:{subindex:02X}h = {value}"

    def read(self, index, subindex=0):
        """Expedited upload: the value, or the abort code."""
        answer = self.request(0x40, *struct.pack("<HB", index, subindex))
        if answer[0] == 0x80:
            return SdoAbortCode(int.from_bytes(answer[4:], "little"))
        return decode(self._types.get((index, subindex), DataType.DOMAIN), answer[4 : 8 - (answer[0] >> 2 & 3)])

    def download(self, index, subindex, data):
        """Write bytes of any length; the abort code as a number, or None."""
        if 0 < len(data) <= 4:
            answer = self.request(0x23 | (4 - len(data)) << 2, *struct.pack("<HB", index, subindex), *data)
            return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else None
        answer, toggle = self.request(0x21, *struct.pack("<HBI", index, subindex, len(data))), 0
        while answer[0] != 0x80:
            segment, data = data[:7], data[7:]
            answer = self.request(toggle | (7 - len(segment)) << 1 | (not data), *segment.ljust(7, b"\0"))
            toggle ^= 0x10
            if not data:
                break
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else None

    def upload(self, index, subindex=0):
        """The bytes of any entry, or the abort code as a number."""
        answer = self.request(0x40, *struct.pack("<HB", index, subindex))
        if answer[0] == 0x80:
            return int.from_bytes(answer[4:], "little")
        if answer[0] & 2:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle, is_last = b"", 0, False
        while not is_last:
            answer = self.request(0x60 | toggle)
            data += answer[1 : 8 - (answer[0] >> 1 & 7)]
            is_last, toggle = answer[0] & 1, toggle ^ 0x10
        return data

    def save(self, index=0x1010, subindex=1, signature=b"save", patience_ms=5000):
        """Store, and wait for the answer; the abort code as a number, or None."""
        response = 0x580 + self.node
        frames = self.send(0x600 + self.node, b"\x23" + struct.pack("<HB", index, subindex) + signature)
        while not (answers := [f for f in frames if f.can_id == response]) and patience_ms > 0:
            frames, patience_ms = self.wait(10), patience_ms - 10
        assert len(answers) == 1
        return int.from_bytes(answers[0].data[4:], "little") if answers[0].data[0] == 0x80 else None

    def power_cycle(self):
        frames = self.world.power_cycle(self.node)
        self.seen += frames
        return frames

    # -- drive

    def word(self, *words):
        for word in words:
            self.set(Object.CONTROL_WORD, 0, word)
        return self.state

    @property
    def status(self):
        return self.read(Object.STATUS_WORD)

    @property
    def state(self):
        return state_of(self.status)

    @property
    def speed_rps(self):
        """Of the plant, not of the drive's opinion."""
        return float(self.plant["motor_speed_rad_s"]) / TURN

    @property
    def position_rev(self):
        return float(self.plant["motor_angle_rad"]) / TURN

    def enable(self, mode, **objects):
        """Through the state machine, as a master does it."""
        self.set(Object.MODES_OF_OPERATION, 0, mode)
        self.start()
        assert self.word(0x06) is State.READY_TO_SWITCH_ON
        assert self.word(0x07) is State.SWITCHED_ON
        assert self.word(0x0F) is State.OPERATION_ENABLED

    def map_pdo(self, record, mapped, transmission=1):
        """Map a PDO the way CiA 301 asks for; 1400h or 1800h and up."""
        cob_id = self.read(record, 1)
        self.set(record, 1, cob_id | 1 << 31)
        self.set(record + 0x200, 0, 0)
        for number, (index, subindex, bits) in enumerate(mapped, 1):
            self.set(record + 0x200, number, index << 16 | subindex << 8 | bits)
        self.set(record + 0x200, 0, len(mapped))
        self.set(record, 2, transmission)
        self.set(record, 1, cob_id & ~(1 << 31))

    def cyclic(self, mode, torque=False):
        """RPDO 1 with control word and target, TPDO 1 with status word, position and torque, on SYNC; then enable."""
        self.map_pdo(0x1400, (CONTROL, TARGET_TORQUE if torque else TARGET))
        self.map_pdo(0x1800, (STATUS, POSITION, TORQUE))
        self.enable(mode)

    def command(self, word, target, layout="<Hi"):
        return self.send(0x200 + self.node, struct.pack(layout, word, target))

    def cycle(self, target, word=0x0F, layout="<Hi"):
        """One cycle: the command, SYNC, and (status word, position, torque) from the TPDO."""
        self.command(word, target, layout)
        feedback = [f for f in self.sync() if f.can_id == 0x180 + self.node]
        assert len(feedback) == 1
        return struct.unpack("<Hih", feedback[0].data)

    def turn(self, speed_rps, seconds, rate_rps_s=20.0, period_s=0.002):
        """Cyclic position set-points: speed up at a rate, then hold the speed; gives the last target."""
        target, speed = float(self.read(Object.TARGET_POSITION)), self.speed_rps
        for _ in range(round(seconds / period_s)):
            change = rate_rps_s * period_s
            speed += min(change, max(-change, speed_rps - speed))
            target += speed * period_s * COUNTS_PER_REV
            self.cycle(round(target))
        return round(target)


class Stranger(canopen.Network):
    """The canopen package as master: what it sends goes into the world, what comes out goes to it before the call returns."""

    def __init__(self, rig):
        super().__init__()
        self.rig = rig

    def send_message(self, can_id, data, remote=False):
        if not remote:
            self.deliver(self.rig.send(can_id, bytes(data)))

    def deliver(self, frames):
        for frame in frames:
            self.notify(frame.can_id, bytearray(frame.data), self.rig.world.now * 1e-9)
