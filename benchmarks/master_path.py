"""The master's path: SYNC, N answers, the control law, N commands, against nodes that only echo."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from benchmarks.echo import feedback_ids
from benchmarks.measure import Row, in_turn, progress, table
from benchmarks.robots import SINGLE, bench_of
from benchmarks.stranger import Master, Nodes
from benchmarks.whole_bench import wait_for
from drive_profiles.address import LOCAL, SOCKETCAN, Address
from drive_profiles.cia402 import Mode
from hil.can import clock
from hil.can.channel import Channel
from hil.can.frame import RECORD, Frame, pack
from hil.can.raw import RawChannel, connect_local, share_core
from hil.control.servo import Servo, ServoConfig
from hil.control.servo_bank import ServoBank
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
            self._takers[can_id] = slot.take_feedback
        self.expect(set(self._takers))


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
    configs = [law.config for law in laws(count)]
    bank, references = ServoBank(configs, PERIOD_S), [0.0] * count

    def cycle() -> None:
        plan.exchange()
        if plan.missing_answers:
            raise RuntimeError("a node has not answered")
        torques = bank.step(references, [slot.position_rad for slot in plan.slots])
        for slot, torque in zip(plan.slots, torques, strict=True):
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

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Forget them."""

    def receive_all(self, timeout_s: float) -> list[Frame]:
        """Nothing comes."""
        return []

    def close(self) -> None:
        """Leave."""


def bare(sock: socket.socket, count: int) -> Callable[[], None]:
    """The same frames, one message each, and nothing else."""
    commands = _commands(count)
    sync, size = pack(Frame(0x80, b"")), RECORD.size
    send, recv = sock.send, sock.recv

    def cycle() -> None:
        for command in commands:
            send(command)
        send(sync)
        for _ in range(count):
            recv(size)

    return cycle


def bare_together(sock: socket.socket, count: int) -> Callable[[], None]:
    """The same frames in one message each way, and nothing else: no master in Python on this path can be faster."""
    message = b"".join(_commands(count)) + pack(Frame(0x80, b""))
    size = count * RECORD.size
    sock.send(pack(clock.question(several=True)))
    sock.recv(size)
    send, recv = sock.send, sock.recv

    def cycle() -> None:
        send(message)
        if len(recv(size)) != size:
            raise RuntimeError("not all answers came together")

    return cycle


def _commands(count: int) -> list[bytes]:
    return [pack(Frame(can_id + 0x80, b"\x0f\x00\x01\x00\x00\x00")) for can_id in feedback_ids(count)]


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
        first, second, third = (Address(LOCAL, str(folder / name)) for name in "abc")
        for address in (first, second, third):
            stack.enter_context(echo(address, count))
        stack.enter_context(Nodes(f"bench-{count}", count))
        master = Master(f"bench-{count}", count)
        stack.callback(master.close)
        whole = os.sched_getaffinity(0)
        channel = RawChannel(first)
        stack.callback(channel.close)
        sock, together = (stack.enter_context(connect_local(address)) for address in (second, third))
        os.sched_setaffinity(0, whole)
        share_core(sock)
        os.sched_setaffinity(0, whole)
        share_core(together)
        cores = os.sched_getaffinity(0)
        cycles = {"ours": ours(channel, count), "bare": bare(sock, count), "together": bare_together(together, count)}
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
        together = found["together"]
        rows.append((count, mine, vcan, library, limit, together, mine / library, mine / limit, mine / together))
    heads = ("axes", "ours, local bus, cycles/s", "ours, vcan0", "`canopen` on `virtual`", "bare, a message per frame",
             "bare, a message each way", "ours / `canopen`", "ours / bare, per frame")  # fmt: skip
    note = "" if Path("/sys/class/net", VCAN).exists() else f" There is no {VCAN} here, so SocketCAN was not measured."
    return [*table((*heads, "ours / bare, each way"), rows), "", f"`canopen` on one core or free, whichever was faster.{note}"]
