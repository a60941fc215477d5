"""The master's path: SYNC, N answers, the control law, N commands, against nodes that only echo."""

import contextlib
import math
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.echo import PATTERN, feedback_ids
from benchmarks.measure import Row, agreed, apart, in_turn, progress, table
from benchmarks.robots import SINGLE, bench_of, robot_of
from benchmarks.stranger import Master, Nodes
from benchmarks.whole_bench import wait_for
from drive_profiles.address import LOCAL, SOCKETCAN, Address
from drive_profiles.standard.units import Scaling
from hil.can import clock
from hil.can.channel import Channel
from hil.can.frame import RECORD, Frame, pack
from hil.can.local import LocalChannel, connect_local, one_core
from hil.can.socketcan import SocketCanChannel
from hil.control.servo import Servo, ServoConfig
from hil.control.servo_bank import ServoBank
from hil.master.cyclic import FEEDBACK, POSITION_COMMAND, CyclicExchange
from hil.master.drive.axis import DriveAxis
from hil.master.motion import Motion
from hil.master.network import Network
from hil.master.run import PROGRESS_ROWS, Run
from hil.master.sensor import JointsOnly
from hil.master.supervision import Supervisor
from hil.recording import BusLog

SHARE_S = 0.25
"""How long a turn of one contender lasts."""
PERIOD_S = 250e-6
STRETCH = PROGRESS_ROWS
CHECKED, SWING = 100, 10.0
"""Cycles that are compared before any is timed, and how far the first node's position swings in them, in counts."""
SILENCE_S = 1e6
"""Heartbeats of the bench, since the nodes send none."""
VCAN = "vcan0"


class Contender(NamedTuple):
    """A master and what it sends.

    Attributes:
        cycle: One cycle.
        set_points: What the next one will send.
        put: Change it.
        stretch: `STRETCH` cycles in one call, as those of a motion pass.
    """

    cycle: Callable[[], object]
    set_points: Callable[[], list[int]]
    put: Callable[[list[int]], None]
    stretch: Callable[[], object]

    def path(self) -> list[list[int]]:
        """What the laws make of positions that swing, of each node by its own amount: the torques stay within their limits."""
        found, count = [], len(self.set_points())
        for turn in range(CHECKED):
            self.put([round(SWING * (node + 1) * math.sin(math.tau * turn / CHECKED)) for node in range(count)])
            self.cycle()
            found.append(self.set_points())
        return found


FAR = 1e6
"""Limits of revolutions and of revolutions per second that no echo reaches."""


class EchoExchange(CyclicExchange):
    """The exchange with nodes that need no configuration: their PDOs are what they are."""

    def configure(self) -> None:
        """Take the identifiers; nothing is sent."""
        for slot, can_id in zip(self.slots, feedback_ids(len(self.slots)), strict=True):
            slot.send_command_as(can_id + 0x80, POSITION_COMMAND)
            slot.feedback_id, slot.control_word = can_id, 0x0F
        self.data.tip = self.sensor.configure().source
        self.expect({slot.feedback_id: (FEEDBACK, row) for row, slot in enumerate(self.slots)})


def laws(count: int) -> list[Servo]:
    """A servo law for each axis, with the gains of the reference bench."""
    table = bench_of(1).axis[SINGLE]
    return [Servo(ServoConfig(table.control.cascade(), table.limits.torque_nm), PERIOD_S) for _ in range(count)]


def scale() -> Scaling:
    """What the reference robot's drive would tell of its encoder and its rated torque."""
    axis = robot_of(1).axis[SINGLE]
    return Scaling(axis.encoder_counts_per_rev, axis.rated_torque)


def rate(cycle: Callable[[], object], cycles: int = 1) -> float:
    """Cycles per second; so many are one call."""
    count, begin = 0, time.perf_counter()
    while (took := time.perf_counter() - begin) < SHARE_S:
        for _ in range(max(1, 50 // cycles)):
            cycle()
            count += cycles
    return count / took


def ours(channel: Channel, count: int) -> Contender:
    """The shipped master: `Run.follow`, which exchanges, checks the axes, closes their loops, and keeps frames for the log."""
    bench = bench_of(1)
    network = Network(channel, BusLog(Path(os.devnull)), 1.0, PERIOD_S)
    table = bench.axis[SINGLE]  # an echo jumps: its limits are checked, and far away
    far = table.limits.model_copy(update={"speed_rps": FAR, "position_min_rev": -FAR, "position_max_rev": FAR})
    axes = [DriveAxis(network, n + 1, table.model_copy(update={"limits": far})) for n in range(count)]
    for axis in axes:
        axis.scaling = scale()
    exchange = EchoExchange(network, axes, JointsOnly(), PERIOD_S, loop="drive", with_notch_state=False, max_lateness_s=1.0)
    exchange.configure()
    supervisor = Supervisor(network, bench.bus.model_copy(update={"heartbeat_s": SILENCE_S}))
    supervisor.begin(axis.number for axis in axes)
    bank, references = ServoBank([law.config for law in laws(count)], PERIOD_S), np.zeros((STRETCH, count))
    rest = Motion(tuple(axis.number for axis in axes), PERIOD_S * np.arange(STRETCH), references, starts_at_home=True)
    run = Run(rest, axes, exchange, bench, supervisor, [0.0] * count, bank=bank)

    def follow(cycles: int) -> None:
        run.follow(references[:cycles], 0)
        if exchange.missed_cycles:
            raise RuntimeError("a node has not answered")

    def put(targets: list[int]) -> None:
        for slot, target in zip(exchange.slots, targets, strict=True):
            slot.target = target

    return Contender(lambda: follow(1), lambda: [slot.target for slot in exchange.slots], put, lambda: follow(STRETCH))


def theirs(master: Master, count: int) -> Contender:
    """The same work by the `canopen` package."""
    servos, scaling = laws(count), [scale()] * count

    def law(n: int, counts: int) -> int:
        return int(scaling[n].torque_per_mille(servos[n].step(0.0, scaling[n].position_rad(counts))))

    def stretch() -> None:
        for _ in range(STRETCH):
            master.cycle(law)

    return Contender(lambda: master.cycle(law), master.set_points, master.put, stretch)


def bare(sock: socket.socket, count: int) -> Callable[[], bytes]:
    """The same frames, one message each, and nothing else; what has come."""
    commands = _commands(count)
    sync, size = pack(Frame(0x80, b"")), RECORD.size
    send, recv = sock.send, sock.recv

    def cycle() -> bytes:
        for command in commands:
            send(command)
        send(sync)
        return b"".join([recv(size) for _ in range(count)])

    return cycle


def bare_together(sock: socket.socket, count: int) -> Callable[[], bytes]:
    """The same frames in one message each way, and nothing else: no cycle in Python is faster on this path; what has come."""
    message = b"".join(_commands(count)) + pack(Frame(0x80, b""))
    size = count * RECORD.size
    sock.send(pack(clock.question(several=True)))
    sock.recv(size)
    send, recv = sock.send, sock.recv

    def cycle() -> bytes:
        send(message)
        answers = recv(size)
        if len(answers) != size:
            raise RuntimeError("not all answers came together")
        return answers

    return cycle


def _answers(count: int) -> bytes:
    """What nodes say to `_commands`."""
    return b"".join(pack(Frame(can_id, PATTERN[:2] + _POSITION + PATTERN[6:])) for can_id in feedback_ids(count))


_POSITION = b"\x01\x00\x00\x00"


def _commands(count: int) -> list[bytes]:
    return [pack(Frame(can_id + 0x80, b"\x0f\x00" + _POSITION)) for can_id in feedback_ids(count)]


@contextlib.contextmanager
def echo(address: Address, count: int) -> Iterator[None]:
    """The echoing nodes as a process."""
    command = [sys.executable, "-m", "benchmarks.echo", str(address), str(count)]
    process = subprocess.Popen(command)  # noqa: S603 - our own interpreter and module
    try:
        if address.interface == LOCAL:
            wait_for(address, process)
        else:
            time.sleep(1.0)
        yield
    finally:
        process.terminate()
        process.wait()


def _on_vcan(count: int, path: list[list[int]]) -> float | None:
    """Ours on SocketCAN, on the beat of nobody: as fast as it goes, set-points held against a path; None without vcan0."""
    if not Path("/sys/class/net", VCAN).exists():
        return None
    address = Address(SOCKETCAN, VCAN)
    with echo(address, count):
        channel = SocketCanChannel(address)
        channel.is_lock_step = True  # each cycle follows the last one's answers; nothing else of the path is changed
        try:
            mine = ours(channel, count)
            agreed(f"ours on {VCAN}, {count} axes, set-points", apart(mine.path(), path), 0.0)
            return rate(mine.stretch, STRETCH)
        finally:
            channel.close()


def _contend(count: int) -> tuple[dict[str, float], list[list[int]]]:
    """The rates, and the set-points on which all agree."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-")))
        first, second, third = (Address(LOCAL, str(folder / name)) for name in "abc")
        for address in (first, second, third):
            stack.enter_context(echo(address, count))
        stack.enter_context(Nodes(f"bench-{count}", count))
        master = Master(f"bench-{count}", count)
        stack.callback(master.close)
        whole = os.sched_getaffinity(0)
        channel = LocalChannel(first)
        stack.callback(channel.close)
        sock, together = (stack.enter_context(connect_local(address)) for address in (second, third))
        stack.enter_context(one_core(together))
        stack.enter_context(one_core(sock))
        stack.enter_context(channel.on_one_core())
        cores = os.sched_getaffinity(0)
        mine, library = ours(channel, count), theirs(master, count)
        limits = {"bare": bare(sock, count), "together": bare_together(together, count)}
        cycles: dict[str, Callable[[], object]] = {"ours": mine.cycle, **limits}
        path = mine.path()
        if np.ptp(path) == 0:
            raise RuntimeError("the laws have had nothing to do")
        agreed(f"`canopen`, {count} axes, set-points", apart(library.path(), path), 0.0)
        for name, cycle in limits.items():
            agreed(f"{name}, {count} axes, bytes of the answers", apart([*cycle()], [*_answers(count)]), 0.0)

        def on(cpus: set[int], cycle: Callable[[], object], cycles: int = 1) -> float:
            os.sched_setaffinity(0, cpus)
            return rate(cycle, cycles)

        contenders = {name: lambda cycle=cycle: on(cores, cycle) for name, cycle in cycles.items()}
        contenders["stretches"] = lambda: on(cores, mine.stretch, STRETCH)
        contenders["canopen"] = lambda: on(cores, library.cycle)
        contenders["canopen, free"] = lambda: on(whole, library.cycle)
        return in_turn(contenders), path


def master_path(counts: tuple[int, ...] = (1, 3, 6)) -> list[str]:
    """Cycles per second of each, and the ratios.

    Raises:
        DisagreementError: One of them sends other set-points than ours, or hears other answers.
    """
    rows: list[Row] = []
    for count in counts:
        progress(f"master: {count} axes")
        found, path = _contend(count)
        library = max(found["canopen"], found["canopen, free"])
        mine, limit, together = found["stretches"], found["bare"], found["together"]
        rows.append((count, mine, found["ours"], _on_vcan(count, path), library, limit, together,
                     mine / library, mine / limit, mine / together, found["ours"] / together))  # fmt: skip
    heads = ("axes", "ours, local bus, cycles/s", "a cycle a call", "ours, vcan0", "`canopen` on `virtual`",
             "bare, one message per frame", "bare, one message per direction", "ours / `canopen`", "ours / bare, per frame",
             "ours / bare, per direction", "a cycle a call / bare, per direction")  # fmt: skip
    note = "" if Path("/sys/class/net", VCAN).exists() else f" There is no {VCAN} here, so SocketCAN was not measured."
    faster = "`canopen` ran on one core and on all cores; the table has the faster of the two."
    return [*table(heads, rows), "", f"{faster}{note}"]
