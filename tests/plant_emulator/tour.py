"""A tour of a served robot by the wall clock: its modes, stops, homing methods and faults; and who watches the bus meanwhile."""

import contextlib
import itertools
import queue
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

from drive_profiles.address import Address
from drive_profiles.standard.cia402 import Mode, Object, State
from hil.can.frame import RECORD, Frame, pack, unpack
from hil.can.local import LocalChannel, connect_local
from plant_emulator.bus.clients import SO_TIMESTAMPNS
from plant_emulator.drive.dictionary.cia402_objects import HOMING_METHODS
from plant_emulator.drive.dictionary.manufacturer_objects import SET_POINT_TIMEOUT, USER_TEXT
from plant_emulator.robots.robot import REFERENCE, load_robot, with_drives
from tests.plant_emulator.rig import AXIS, TURN, Rig

SENSOR = 16
"""Another node, whose heartbeats are watched."""
BEAT_MS = 10
GAP_S = 0.05
MASTER = 127
PATIENCE_S = 20.0
LATE_LOOK_S = 0.15

SWITCHED = """
[axis.3.control]
position_gain_per_s = 25.0
velocity_gain_nm_s_rad = 0.0905
velocity_integral_gain_nm_rad = 1.81

[axis.3.switches]
negative_limit_deg = -8.0
positive_limit_deg = 8.0
home_deg = [2.0, 4.0]
index_deg = 90.0
probe_1_deg = [1.0, 1.5]
"""


def robot_file(folder):
    """The reference robot, its axis 3 with gains and switches."""
    path = folder / "robot.toml"
    path.write_text(REFERENCE.read_text(encoding="utf-8") + SWITCHED, encoding="utf-8")
    return path


def file_of_drives(folder, count):
    """A robot whose axes 1 to `count` are each that axis 3, and no arm."""
    lines = REFERENCE.read_text(encoding="utf-8").splitlines()
    begin = lines.index("[axis.3]")
    end = next(number for number in range(begin + 1, len(lines)) if lines[number].startswith("["))
    axis = "\n".join(line for line in lines[begin:end] if not line.startswith("node_id")) + SWITCHED
    axes = [axis.replace("[axis.3", f"[axis.{number}") for number in range(1, count + 1)]
    path = folder / "robot.toml"
    path.write_text("\n".join((*lines[: lines.index("[axis.2]")], *axes)), encoding="utf-8")
    return path


def processor_ns(pid):
    """Time that all threads of a process have had of the processor."""
    return sum(int((task / "schedstat").read_text().split()[0]) for task in Path(f"/proc/{pid}/task").iterdir())


class Watch:
    """Hears another node's heartbeats: how far apart the server has sent them, and how much it has worked meanwhile.

    The kernel tells when each came, however late this thread looks. A gap counts by the server's own work in it: a machine that
    gives it no processor delays heartbeats too, and that is none of its doing.

    Attributes:
        worst_s: The longest gap that was the server's own work, and what the tour was at.
        at: What the tour is at.
        beats: Number of heartbeats heard.
        missed: Looks that came so late that they tell nothing.
    """

    def __init__(self, path, pid):
        self.worst_s, self.at, self.beats, self.missed = (0.0, ""), "the start", 0, 0
        self._socket = connect_local(Address("local", str(path)))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.setblocking(False)
        self._pid, self._is_on = pid, True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _arrivals(self):
        """When the heartbeats came that wait, in ns; waits a little for the first frame."""
        arrivals = []
        select.select([self._socket], [], [], 0.005)
        with contextlib.suppress(BlockingIOError):
            while True:
                record, ancillary, _, _ = self._socket.recvmsg(RECORD.size, 64)
                if RECORD.unpack(record)[0] == 0x700 + SENSOR:
                    seconds, nanoseconds = struct.unpack("@ll", ancillary[0][2])
                    arrivals.append(seconds * 10**9 + nanoseconds)
        return arrivals

    def _run(self):
        last, looked, worked = None, time.monotonic(), processor_ns(self._pid)
        while self._is_on:
            arrivals, at = self._arrivals(), self.at
            if not arrivals:
                continue
            now, work = time.monotonic(), processor_ns(self._pid)
            known = arrivals if last is None else [last, *arrivals]
            gap = max((later - earlier for earlier, later in itertools.pairwise(known)), default=0)
            if now - looked > gap * 1e-9 + LATE_LOOK_S:
                self.missed += 1
            else:
                self.worst_s = max(self.worst_s, (1e-9 * min(gap, work - worked), at))
            self.beats += len(arrivals)
            last, looked, worked = arrivals[-1], now, work

    def wait_for_beats(self, count):
        """Wait until so many have been heard, or for as long as patience lasts."""
        end = time.monotonic() + PATIENCE_S
        while self.beats < count and time.monotonic() < end:
            time.sleep(1e-3 * BEAT_MS)

    def close(self):
        self._is_on = False
        self._thread.join()
        self._socket.close()


class Line:
    """One socket of many guests: each hears the frames of its own node and those of none, and one SYNC is for all who ask.

    A drive takes a SYNC for its period, so those of fifteen masters would be fifteen times too many.
    """

    PERIOD_S = 0.004

    def __init__(self, path):
        self._socket = connect_local(Address("local", str(path)))
        self._seats = {}
        self._asked, self._syncs, self._turn = False, 0, threading.Condition()
        self._is_on = True
        self._threads = [threading.Thread(target=run) for run in (self._hear, self._beat)]

    def seat(self, node):
        """The channel of the guest of a node."""
        self._seats[node] = Seat(self, node)
        return self._seats[node]

    def open(self):
        """All have their seats: let them hear."""
        for thread in self._threads:
            thread.start()

    def send(self, frame):
        self._socket.send(pack(frame))

    def sync(self):
        """Wait until the next SYNC has been sent."""
        with self._turn:
            self._asked, wanted = True, self._syncs + 1
            assert self._turn.wait_for(lambda: self._syncs >= wanted, PATIENCE_S)

    def _hear(self):
        while self._is_on:
            if not select.select([self._socket], [], [], 0.1)[0]:
                continue
            frame = unpack(self._socket.recv(RECORD.size))
            node = frame.can_id & 0x7F
            if node == SENSOR:
                continue
            for seat in [self._seats[node]] if node in self._seats else self._seats.values():
                seat.frames.put(frame)

    def _beat(self):
        while self._is_on:
            time.sleep(self.PERIOD_S)
            with self._turn:
                if self._asked:
                    self._asked = False
                    self.send(Frame(0x080, b""))
                    self._syncs += 1
                    self._turn.notify_all()

    def close(self):
        self._is_on = False
        for thread in self._threads:
            thread.join()
        self._socket.close()


class Seat:
    """What a guest has of a line: as much of a channel as it needs."""

    def __init__(self, line, node):
        self._line, self._node = line, node
        self.send, self.sync = line.send, line.sync
        self.frames = queue.SimpleQueue()

    def receive(self, timeout_s):
        with contextlib.suppress(queue.Empty):
            return self.frames.get(timeout=timeout_s) if timeout_s > 0.0 else self.frames.get_nowait()
        return None

    def close(self):
        """The line is closed by whom it belongs to."""


class Guest(Rig):
    """The rig's master, on a channel instead of in the robot's process.

    Attributes:
        twin: The drive as it left the factory, for its types and units.
        sides: Each motion goes the other way than the one before.
    """

    def __init__(self, channel, robot, axis=AXIS):
        super().__init__(robot, axis)
        self.twin, self.seen = self.drive, []
        self.sides = itertools.cycle((1.0, -1.0))
        self._channel = channel

    def _drained(self, timeout_s):
        frames = []
        while (frame := self._channel.receive(timeout_s)) is not None:
            frames.append(frame)
            timeout_s = 0.0
        self.seen += frames
        return frames

    def send(self, can_id, data=b""):
        self._channel.send(Frame(can_id, bytes(data)))
        frames = self._drained(0.0)
        if can_id == 0x600 + self.node and data[0] != 0x80:
            end = time.monotonic() + PATIENCE_S
            while not any(frame.can_id == 0x580 + self.node for frame in frames):
                assert time.monotonic() < end, f"no answer to {bytes(data).hex()}"
                frames += self._drained(0.05)
        return frames

    def wait(self, milliseconds):
        end = time.monotonic() + 1e-3 * milliseconds
        frames = []
        while (left := end - time.monotonic()) > 0.0:
            frames += self._drained(left)
        return frames

    def sync(self, count=1):
        frames = []
        for _ in range(count):
            if isinstance(self._channel, Seat):
                self._channel.sync()
                frames = self.wait(3)  # the next one comes after the fourth
            else:
                frames = self.send(0x080) + self.wait(4)
        return frames

    def wait_for(self, happened, seconds=3.0):
        """Whether it happens in time."""
        end = time.monotonic() + seconds
        while not happened():
            if time.monotonic() > end:
                return False
            self.wait(30)
        return True

    def offer(self, index, subindex, value):
        """Write what a drive may refuse, or not have; whether it has taken it."""
        return (index, subindex) in self._types and self.write(index, subindex, value) is None

    def codes(self):
        """Codes of all emergencies so far."""
        return {code for code in self.emergencies() if code}

    # -- what it asks of the drive

    def units(self, revolutions):
        return self.twin.scaling.position_counts(revolutions * TURN)

    def speed(self, rps):
        return self.twin.scaling.speed_counts_s(rps * TURN)

    def rest(self):
        """Disabled and without a fault."""
        self.offer(Object.CONTROL_WORD, 0, 0)
        self.wait_for(lambda: self.state not in {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
        self.offer(Object.CONTROL_WORD, 0, 0x80)
        self.offer(Object.CONTROL_WORD, 0, 0)

    def enabled(self, mode):
        """Whether the drive is enabled in a mode, from rest."""
        self.rest()
        if not self.offer(Object.MODES_OF_OPERATION, 0, mode):
            return False
        self.start()
        for word, state in ((0x06, State.READY_TO_SWITCH_ON), (0x07, State.SWITCHED_ON), (0x0F, State.OPERATION_ENABLED)):
            self.offer(Object.CONTROL_WORD, 0, word)
            if not self.wait_for(lambda state=state: self.state is state, 1.0):
                return False
        return True

    def moving(self, mode):
        """Whether the motor runs in a mode."""
        if not self.enabled(mode):
            return False
        match mode:
            case Mode.PP:
                self.offer(Object.TARGET_POSITION, 0, self.units(next(self.sides)))
                self.offer(Object.CONTROL_WORD, 0, 0x1F)
            case Mode.PV | Mode.CSV:
                self.offer(Object.TARGET_VELOCITY, 0, self.speed(4.0 * next(self.sides)))
            case Mode.TQ | Mode.CST:
                self.offer(Object.TARGET_TORQUE, 0, round(200 * next(self.sides)))
            case Mode.HM:
                self.offer(Object.HOMING_METHOD, 0, 33)
                self.offer(Object.CONTROL_WORD, 0, 0x1F)
            case _:
                if mode is Mode.IP:
                    self.offer(Object.CONTROL_WORD, 0, 0x1F)
                start = self.read(Object.POSITION_ACTUAL)
                for step in range(5):
                    wanted = start + self.units(0.004 * step)
                    self.offer(Object.INTERPOLATION_DATA, 1, wanted) if mode is Mode.IP else self.offer(
                        Object.TARGET_POSITION, 0, wanted
                    )
                    self.sync()
        self.sync(3)
        self.wait(30)
        return True

    def meet(self):
        """Wait for the other guests, of whom here are none."""

    def close(self):
        self._channel.close()


def prepare(guest):
    """Quick homing and profiles; heartbeats of the accelerometer."""
    guest.send(0x600 + SENSOR, struct.pack("<BHBHH", 0x2B, 0x1017, 0, BEAT_MS, 0))
    guest.start()
    guest.offer(0x1006, 0, 4000)
    guest.offer(Object.INTERPOLATION_PERIOD, 1, 4)
    guest.offer(Object.INTERPOLATION_PERIOD, 2, -3)
    guest.offer(Object.HOMING_SPEEDS, 1, guest.speed(12.0))
    guest.offer(Object.HOMING_SPEEDS, 2, guest.speed(3.0))
    guest.offer(Object.PROFILE_VELOCITY, 0, guest.speed(5.0))
    quick = guest.twin.scaling.acceleration_counts_s2(400.0 * TURN)
    for index in (0x6083, 0x6084, 0x6085, 0x609A):
        guest.offer(index, 0, quick)


# -- stations of the tour: each says what it is at, and whether the drive took part ----------------------------------------


def modes(guest):
    """Every mode, with a halt and a change to the next one under torque."""
    for mode in Mode:
        yield f"mode {mode.name}", guest.moving(mode)
        for option in range(1, 5):
            guest.offer(Object.HALT_OPTION, 0, option)
            guest.offer(Object.CONTROL_WORD, 0, 0x10F)
            yield f"halt {option} in {mode.name}", guest.wait(30) is not None
            guest.offer(Object.CONTROL_WORD, 0, 0x0F)
    guest.moving(Mode.PV)
    for mode in (*Mode, Mode.PV):
        guest.offer(Object.MODES_OF_OPERATION, 0, mode)
        yield f"to {mode.name} under torque", guest.wait(20) is not None


def stops(guest, in_modes=None):
    """Every way to take the enable away, with every value of its option code; in PV where the drive has it."""
    offered = guest.twin.family.modes
    for mode in in_modes or [Mode.PV if Mode.PV in offered else Mode.PP if Mode.PP in offered else offered[0]]:
        for name, index, options, word in (
            ("quick stop", Object.QUICK_STOP_OPTION, range(9), 0x0B),
            ("disable operation", Object.DISABLE_OPERATION_OPTION, range(2), 0x07),
            ("shutdown", Object.SHUTDOWN_OPTION, range(2), 0x06),
            ("disable voltage", Object.SHUTDOWN_OPTION, (0,), 0x00),
        ):
            for option in options:
                if guest.moving(mode):
                    guest.offer(index, 0, option)
                    guest.offer(Object.CONTROL_WORD, 0, word)
                    yield f"{name} {option} in {mode.name}", guest.wait_for(lambda: guest.state is not State.OPERATION_ENABLED)


def homing(guest, methods=HOMING_METHODS):
    """Every homing method."""
    for method in methods:
        if guest.enabled(Mode.HM) and guest.offer(Object.HOMING_METHOD, 0, method):
            guest.offer(Object.CONTROL_WORD, 0, 0x1F)
            guest.wait(10)
            yield f"homing {method}", guest.wait_for(lambda: guest.status & 3 << 12, 8.0)


def reactions(guest):
    """A following error under every fault reaction, and a lost master under every reaction to that."""
    window, timeout = guest.read(Object.FOLLOWING_ERROR_WINDOW), guest.read(Object.FOLLOWING_ERROR_TIMEOUT)
    for option in range(5):
        guest.offer(Object.FAULT_REACTION_OPTION, 0, option)
        guest.seen.clear()
        if guest.enabled(Mode.PP):
            guest.offer(Object.FOLLOWING_ERROR_WINDOW, 0, 1)
            guest.offer(Object.FOLLOWING_ERROR_TIMEOUT, 0, 0)
            guest.offer(Object.TARGET_POSITION, 0, guest.units(next(guest.sides)))
            guest.offer(Object.CONTROL_WORD, 0, 0x1F)
            yield f"8611h with fault reaction {option}", guest.wait_for(lambda: 0x8611 in guest.codes())
        guest.offer(Object.FOLLOWING_ERROR_WINDOW, 0, window)
        guest.offer(Object.FOLLOWING_ERROR_TIMEOUT, 0, timeout)
    for option in range(4):
        guest.offer(Object.ABORT_CONNECTION_OPTION, 0, option)
        guest.seen.clear()
        if guest.moving(Mode.PV):
            guest.set(0x1016, 1, MASTER << 16 | 40)
            guest.heartbeat()
            yield f"8130h with 6007h = {option}", guest.wait_for(lambda: 0x8130 in guest.codes())
        guest.set(0x1016, 1, 0)
        guest.start()
    guest.offer(Object.ABORT_CONNECTION_OPTION, 0, 1)


def faults(guest):
    """Every other fault that a master can bring about."""
    for name, code, provoke in (
        ("a target outside of its limits", 0x8612, _outside),
        ("a set-point that is too fast", 0x8612, _too_fast),
        ("too much speed", 0x8400, _overspeed),
        ("no more SYNC", 0x8700, _without_sync),
        ("an RPDO that stays away", 0x8250, _without_rpdo),
        ("an RPDO that is too short", 0x8210, lambda guest: guest.send(0x200 + guest.node, b"\x06")),
        ("a SYNC with data", 0x8240, lambda guest: guest.send(0x080, b"\1\2")),
        ("a guard that has gone", 0x8130, _without_guard),
    ):
        guest.rest()
        guest.start()
        guest.seen.clear()
        guest.meet()
        provoke(guest)
        yield f"{code:04X}h by {name}", guest.wait_for(lambda code=code: code in guest.codes(), 1.0)
        for index, subindex, value in ((SET_POINT_TIMEOUT, 0, 0), (0x1400, 5, 0), (0x100C, 0, 0), (0x6080, 0, None)):
            if value is not None:
                guest.offer(index, subindex, value)


def _outside(guest):
    guest.enabled(Mode.CSP)
    before = [guest.read(Object.SOFTWARE_POSITION_LIMIT, sub) for sub in (1, 2)]
    here = guest.read(Object.POSITION_ACTUAL)
    guest.offer(Object.SOFTWARE_POSITION_LIMIT, 1, here - guest.units(0.2))
    guest.offer(Object.SOFTWARE_POSITION_LIMIT, 2, here + guest.units(0.2))
    guest.offer(Object.TARGET_POSITION, 0, here + guest.units(0.4))
    guest.sync(3)
    for sub, value in enumerate(before, 1):
        guest.offer(Object.SOFTWARE_POSITION_LIMIT, sub, value)


def _too_fast(guest):
    guest.enabled(Mode.CSP)
    guest.offer(Object.TARGET_POSITION, 0, guest.read(Object.POSITION_ACTUAL) + guest.units(1.5 * next(guest.sides)))
    guest.sync(3)


def _overspeed(guest):
    fastest = guest.read(Object.MAX_MOTOR_SPEED)
    guest.enabled(Mode.CST)
    guest.offer(Object.MAX_MOTOR_SPEED, 0, 60)
    guest.offer(Object.TARGET_TORQUE, 0, round(600 * next(guest.sides)))
    guest.sync(3)
    guest.wait_for(lambda: 0x8400 in guest.codes(), 1.0)
    guest.rest()
    guest.offer(Object.MAX_MOTOR_SPEED, 0, fastest)


def _without_sync(guest):
    guest.offer(SET_POINT_TIMEOUT, 0, 2)
    guest.moving(Mode.CSP)


def _without_rpdo(guest):
    guest.offer(0x1400, 5, 30)
    guest.enabled(Mode.PV)
    guest.send(0x200 + guest.node, b"\x0f\x00")


def _without_guard(guest):
    guest.offer(0x100C, 0, 20)
    guest.offer(0x100D, 0, 2)
    guest.send(0x4000_0000 | 0x700 + guest.node, bytes(1))


def services(guest):
    """Transfers, storing, time, LSS, other NMT states, and a reset."""
    text = bytes(range(32, 96))
    yield "a segmented download", guest.download(USER_TEXT, 0, text) is None
    yield "a segmented upload", guest.upload(USER_TEXT) == text
    yield "a block upload", guest.request(0xA0, *struct.pack("<HB", USER_TEXT, 0), 4)[0] & 0xE1 == 0xC0
    guest.send(0x600 + guest.node, b"\x80" + bytes(7))
    yield "an object that is not there", guest.upload(0x5FFF) == 0x06020000
    guest.rest()
    yield "storing", guest.save() is None
    yield "restoring", guest.save(0x1011, signature=b"load") is None
    guest.send(0x100, bytes(6))
    guest.send(0x4000_0000 | 0x180 + guest.node, bytes(8))
    for command, name in ((2, "stopped"), (128, "pre-operational"), (1, "operational"), (130, "reset"), (129, "reset node")):
        guest.nmt(command)
        yield f"NMT: {name}", guest.wait(60) is not None
    guest.send(0x7E5, b"\x04\x01" + bytes(6))
    guest.send(0x7E5, b"\x5e" + bytes(7))
    guest.send(0x7E5, b"\x04\x00" + bytes(6))
    yield "LSS", any(frame.can_id == 0x7E4 for frame in guest.wait(50))


def parameters(guest):
    """Every object that can be written gets what it holds, or what is near: filters, gains and units act anew."""
    guest.rest()
    guest.nmt(128)
    written = 0
    for entry in guest.twin.slave.dictionary:
        if entry.access.is_writable and entry.index not in range(0x1010, 0x1012) and entry.index != Object.CONTROL_WORD:
            held = guest.upload(entry.index, entry.subindex)
            if isinstance(held, bytes) and guest.download(entry.index, entry.subindex, held) is None:
                written += 1
    yield "what it holds", written > 30


EVERYTHING = (modes, stops, homing, reactions, faults, parameters, services)


def start(folder, *options, drives=(), rate=""):
    """A server process on the robot with switches, its socket, and the robot as it serves it.

    With drives it has an axis for each of them, from 1 on, and nothing else.
    """
    path, file = folder / "robot.sock", file_of_drives(folder, len(drives)) if drives else robot_file(folder)
    profiles = dict(enumerate(drives, 1))
    chosen = [word for axis, drive in profiles.items() for word in ("--drive", f"{axis}={drive}")]
    process = subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", "serve", "--wall", "--robot", str(file), "--bus", f"local:{path}{rate}",
         "--until-stdin-closes", "--store-time-s", "0.05", *chosen, *options],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline().startswith("serving"), process.communicate()[1]
    return process, path, with_drives(load_robot(file), profiles)


def visit(process, path, robot, stations):
    """Go through the stations under the eyes of a `Watch`; who watched, and what the drive did not take part in."""
    watch, guest, idle = Watch(path, process.pid), Guest(LocalChannel(Address("local", str(path))), robot), []
    try:
        prepare(guest)
        for station in stations:
            for name, took_part in station(guest):
                watch.at = name
                idle += [] if took_part else [name]
        guest.wait(10 * BEAT_MS)
    finally:
        guest.close()
        watch.close()
    return watch, idle


def visit_all(process, path, robot, stations):
    """All axes at the same time, each with a guest of its own; who watched, and by axis what it did not take part in.

    The guests bring about each fault together: a SYNC with data, or none any more, befalls the whole bus.
    """
    watch, line, idle, failed = Watch(path, process.pid), Line(path), {axis: [] for axis in robot.axis}, []
    guests = {axis: Guest(line.seat(robot.node_ids[axis]), robot, axis) for axis in robot.axis}
    together = threading.Barrier(len(guests), timeout=120.0)

    def tour(axis, guest):
        try:
            guest.meet = together.wait
            prepare(guest)
            for station in stations:
                for name, took_part in station(guest):
                    watch.at = f"{name} of {robot.axis[axis].profile}"
                    idle[axis] += [] if took_part else [name]
        except threading.BrokenBarrierError:
            pass  # another one has failed, and says why
        except Exception as error:  # noqa: BLE001 - a thread of its own: the test says it
            failed.append(f"{robot.axis[axis].profile}: {error!r}")
            together.abort()

    threads = [threading.Thread(target=tour, args=each) for each in guests.items()]
    switch_s = sys.getswitchinterval()
    sys.setswitchinterval(0.1 * switch_s)  # the one who watches waits for the guests' threads, and must not look late
    line.open()
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        time.sleep(10e-3 * BEAT_MS)
    finally:
        sys.setswitchinterval(switch_s)
        line.close()
        watch.close()
    assert failed == []
    assert not together.broken, "one has kept the others waiting"
    return watch, idle


def end(process):
    """End a server; what it has said on standard error."""
    process.stdin.close()
    process.stdin = None
    return process.communicate(timeout=30)[1]
