"""What a frame costs one emulated node, without a bus, by service; and `canopen`'s local node where it has the service."""

import binascii
import itertools
import struct
import time
from collections.abc import Callable, Sequence

import canopen

from benchmarks.measure import Row, agreed, apart, in_turn, progress, table
from benchmarks.robots import FIRST_NODE, SINGLE
from benchmarks.stranger import dictionary
from hil.can.frame import Frame
from plant_emulator.robots.robot import Robot, load_robot
from plant_emulator.world import World

NODE, ROUNDS = FIRST_NODE + SINGLE, 20_000
_COMMUNICATION = {"rpdo": (0x1400, 0x200), "tpdo": (0x1800, 0x180)}


def _sdo(index: int, subindex: int, data: bytes) -> Frame:
    return Frame(0x600 + NODE, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0"))


def _mapped(kind: str, mapped: Sequence[int]) -> list[Frame]:
    communication, base = _COMMUNICATION[kind]
    mapping, cob_id = communication + 0x200, base + NODE
    return [
        _sdo(communication, 1, struct.pack("<I", 1 << 31 | cob_id)),
        _sdo(mapping, 0, b"\0"),
        *(_sdo(mapping, place, struct.pack("<I", value)) for place, value in enumerate(mapped, 1)),
        _sdo(mapping, 0, bytes((len(mapped),))),
        _sdo(communication, 2, b"\1"),
        _sdo(communication, 1, struct.pack("<I", cob_id)),
    ]


def _drive() -> Callable[[Frame], list[Frame]]:
    """An operational drive of a robot of one axis, its PDOs as a bench maps them."""
    axis = load_robot("reference").axis[3].model_copy(update={"node_id": NODE})
    world = World(Robot(axis={3: axis}))
    world.power_on()
    slave = world.drives[3].slave
    times = itertools.count(world.now)
    setup = [
        *_mapped("rpdo", (0x60400010, 0x607A0020)),
        *_mapped("tpdo", (0x60410010, 0x60640020, 0x60770010)),
        Frame(0x000, bytes((1, NODE))),
    ]
    for frame in setup:
        slave.receive(frame, next(times))
    return lambda frame: slave.receive(frame, next(times))


def _rate(give: Callable[[Frame], object], frames: Sequence[Frame]) -> float:
    """Frames per second; less what the loop itself takes."""
    turns = ROUNDS // len(frames)
    begin = time.perf_counter()
    for _ in range(turns):
        for frame in frames:
            give(frame)
    took = time.perf_counter() - begin
    begin = time.perf_counter()
    for _ in range(turns):
        for _frame in frames:
            pass
    return turns * len(frames) / (took - (time.perf_counter() - begin))


def _block(length: int) -> list[Frame]:
    """A block download of the drive's text, its end included."""
    data = bytes(48 + i % 10 for i in range(length))
    segments = [data[at : at + 7] for at in range(0, length, 7)]
    frames = [Frame(0x600 + NODE, struct.pack("<BHBI", 0xC6, 0x2FF0, 0, length))]
    for number, segment in enumerate(segments, 1):
        frames.append(Frame(0x600 + NODE, bytes((number | (number == len(segments)) << 7,)) + segment.ljust(7, b"\0")))
    unused = 7 * len(segments) - length
    frames.append(Frame(0x600 + NODE, struct.pack("<BH5x", 0xC1 | unused << 2, binascii.crc_hqx(data, 0))))
    return frames


def node_frames() -> list[str]:
    """Microseconds that one frame costs one node, by kind of frame.

    Raises:
        DisagreementError: `canopen`'s node answers something else than ours.
    """
    progress("node: what a frame costs")
    drive = _drive()
    read, write = Frame(0x600 + NODE, struct.pack("<BHBI", 0x40, 0x1018, 1, 0)), _sdo(0x6083, 0, struct.pack("<I", 100_000))
    services: dict[str, Sequence[Frame]] = {
        "SYNC, one TPDO of 8 bytes sent": [Frame(0x080, b"")],
        "RPDO of 6 bytes, then SYNC": [Frame(0x200 + NODE, struct.pack("<Hi", 6, 0)), Frame(0x080, b"")],
        "SDO read of 4 bytes": [read],
        "SDO write of 4 bytes": [write],
        "SDO block write of 840 bytes, per frame": _block(840),
        "NMT command to another node": [Frame(0x000, bytes((1, 126)))],
        "a frame for other nodes": [Frame(0x181, bytes(8))],
    }
    network = canopen.Network()
    sent: list[bytes] = []
    network.send_message = lambda _can_id, data, *_args, **_kwargs: sent.append(bytes(data))  # type: ignore[method-assign]
    [answer] = drive(read)
    stranger = canopen.LocalNode(NODE, dictionary(int.from_bytes(answer.data[4:], "little")))
    stranger.associate_network(network)
    stranger.sdo.on_request(read.can_id, read.data, 0.0)
    agreed("`canopen`'s local node, bytes of its answers", apart([*b"".join(sent)], [*answer.data]), 0.0)
    network.send_message = lambda *_args, **_kwargs: None  # type: ignore[method-assign]
    theirs = {"SDO read of 4 bytes": read}
    contenders: dict[str, Callable[[], float]] = {
        name: lambda frames=frames: _rate(drive, frames) for name, frames in services.items()
    }
    contenders |= {
        f"canopen {name}": lambda frame=frame: _rate(lambda f: stranger.sdo.on_request(f.can_id, f.data, 0.0), [frame])
        for name, frame in theirs.items()
    }
    found = in_turn(contenders, 3)
    rows: list[Row] = []
    for name in services:
        other = found.get(f"canopen {name}")
        theirs_us, ratio = (None, None) if other is None else (1e6 / other, found[name] / other)
        rows.append((name, 1e6 / found[name], theirs_us, ratio))
    return table(("frame", "µs per frame, our drive", "µs, `canopen`'s local node", "our speed / its"), rows)
