"""The master's path: SYNC, N answers, the control law, N commands, against nodes that only echo."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.echo import feedback_ids
from benchmarks.measure import Row, in_turn, progress, table
from benchmarks.robots import SINGLE, bench_of
from benchmarks.stranger import Master, Nodes
from benchmarks.whole_bench import wait_for
from drive_profiles.address import LOCAL, SOCKETCAN, Address
from drive_profiles.cia402 import Mode
from hil.can.channel import Channel
from hil.can.frame import RECORD, Frame, pack
from hil.can.raw import RawChannel, connect_local, share_core
from hil.control.servo import Servo, ServoConfig
from hil.master.axis import DriveAxis
from hil.master.cyclic import CyclicPlan
from hil.master.network import Network
from hil.recording import BusLog

SHARE_S = 0.25
"""How long a turn of one contender lasts."""
PERIOD_S = 250e-6
VCAN = "vcan0"


class EchoPlan(CyclicPlan):
    """The cyclic plan of nodes that need no configuration: their PDOs are what they are."""

    def configure(self) -> None:
        """Take the identifiers; nothing is sent."""
        for slot, can_id in zip(self.slots, feedback_ids(len(self.slots)), strict=True):
            slot._command_id, slot.feedback_id, slot.control_word = can_id + 0x80, can_id, 0x0F
            self._by_id[can_id] = slot
        self._expected = frozenset(self._by_id)


def laws(count: int) -> list[Servo]:
    """A servo law for each axis, with the gains of the reference bench."""
    table = bench_of(1).axis[SINGLE]
    return [Servo(ServoConfig(table.control.cascade(), table.limits.torque_nm), PERIOD_S) for _ in range(count)]


def rate(cycle: Callable[[], None]) -> float:
    """Cycles per second."""
    count, begin = 0, time.perf_counter()
    while (took := time.perf_counter() - begin) < SHARE_S:
        for _ in range(50):
            cycle()
        count += 50
    return count / took


def ours(channel: Channel, count: int) -> Callable[[], None]:
    """A cycle of the shipped master: `CyclicPlan.exchange` and the servo law, in SI through the axes' scaling."""
    bench = bench_of(1)
    network = Network(channel, BusLog(None), 1.0, PERIOD_S)
    axes = [DriveAxis(network, n + 1, bench.axis[SINGLE]) for n in range(count)]
    plan = EchoPlan(network, axes, 0, PERIOD_S, mode=Mode.CSP, with_notch_state=False, max_lateness_s=1.0)
    plan.configure()
    servos = laws(count)

    def cycle() -> None:
        plan.exchange()
        if plan.missing_answers:
            raise RuntimeError("a node has not answered")
        for slot, servo in zip(plan.slots, servos, strict=True):
            torque = servo.step(0.0, slot.axis.scaling.position_rad(slot.position_counts))
            slot.target = slot.axis.scaling.torque_per_mille(torque)

    return cycle


def theirs(master: Master, count: int) -> Callable[[], None]:
    """The same work by the `canopen` package."""
    servos = laws(count)
    scaling = [DriveAxis(Network(_Nowhere(), BusLog(None), 1.0, PERIOD_S), 1, bench_of(1).axis[SINGLE]).scaling] * count

    def law(n: int, counts: int) -> int:
        return int(scaling[n].torque_per_mille(servos[n].step(0.0, scaling[n].position_rad(counts))))

    return lambda: master.cycle(law)


class _Nowhere:
    """A channel for those who need none."""

    is_lock_step, overflows, address = True, 0, Address(LOCAL, "nowhere")

    def send(self, frame: Frame) -> None:
        """Forget it."""

    def receive(self, timeout_s: float) -> Frame | None:
        """Nothing comes."""
        return None

    def close(self) -> None:
        """Leave."""


def bare(sock: socket.socket, count: int) -> Callable[[], None]:
    """The same frames and nothing else: no master in Python on this path can be faster."""
    commands = [pack(Frame(can_id + 0x80, b"\x0f\x00\x01\x00\x00\x00")) for can_id in feedback_ids(count)]
    sync, size = pack(Frame(0x80, b"")), RECORD.size
    send, recv = sock.send, sock.recv

    def cycle() -> None:
        for command in commands:
            send(command)
        send(sync)
        for _ in range(count):
            recv(size)

    return cycle


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


def _on_vcan(count: int) -> float | None:
    """Ours on SocketCAN, on the beat of nobody: as fast as it goes; None where there is no vcan0."""
    if not Path("/sys/class/net", VCAN).exists():
        return None
    address = Address(SOCKETCAN, VCAN)
    with echo(address, count):
        channel = RawChannel(address)
        channel.is_lock_step = True  # each cycle follows the last one's answers; nothing else of the path is changed
        try:
            return rate(ours(channel, count))
        finally:
            channel.close()


def _contend(count: int) -> dict[str, float]:
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-")))
        first, second = Address(LOCAL, str(folder / "a")), Address(LOCAL, str(folder / "b"))
        for address in (first, second):
            stack.enter_context(echo(address, count))
        stack.enter_context(Nodes(f"bench-{count}", count))
        master = Master(f"bench-{count}", count)
        stack.callback(master.close)
        whole = os.sched_getaffinity(0)
        channel = RawChannel(first)
        stack.callback(channel.close)
        sock = stack.enter_context(connect_local(second))
        os.sched_setaffinity(0, whole)
        share_core(sock)
        cores = os.sched_getaffinity(0)
        cycles = {"ours": ours(channel, count), "bare": bare(sock, count)}
        library = theirs(master, count)

        def on(cpus: set[int], cycle: Callable[[], None]) -> float:
            os.sched_setaffinity(0, cpus)
            return rate(cycle)

        contenders = {name: lambda cycle=cycle: on(cores, cycle) for name, cycle in cycles.items()}
        return in_turn(contenders | {"canopen": lambda: on(cores, library), "canopen, free": lambda: on(whole, library)})


def master_path(counts: tuple[int, ...] = (1, 3, 6)) -> list[str]:
    """Cycles per second of each, and the ratios."""
    rows: list[Row] = []
    for count in counts:
        progress(f"master: {count} axes")
        found = _contend(count)
        library = max(found["canopen"], found["canopen, free"])
        mine, limit = found["ours"], found["bare"]
        vcan = _on_vcan(count)
        rows.append((count, mine, vcan, library, limit, mine / library, mine / limit))
    heads = ("axes", "ours, local bus, cycles/s", "ours, vcan0", "`canopen` on `virtual`", "bare ping-pong", "ours / `canopen`")
    note = "" if Path("/sys/class/net", VCAN).exists() else f" There is no {VCAN} here, so SocketCAN was not measured."
    return [*table((*heads, "ours / bare"), rows), "", f"`canopen` on one core or free, whichever was faster.{note}"]
